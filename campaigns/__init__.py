"""Campaigns: how a recording comes to be: scripts, plans, the bench and the runner."""
