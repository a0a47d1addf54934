"""Simulated hardware behind real wire protocols. Shares no code with ppshw, drivers or campaigns."""
