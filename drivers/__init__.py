"""Drivers: one file per wire protocol. Each knows only its port, a clock and its own wire."""
