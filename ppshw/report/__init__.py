"""One self-contained page about a machine's calibration, from the folder that it was made in."""

from __future__ import annotations

from ppshw.report.page import build_report

__all__ = ["build_report"]
