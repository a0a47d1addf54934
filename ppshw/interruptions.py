"""The signals by which somebody asks a program to end. Windows has neither SIGHUP nor SIGQUIT."""

import signal

INTERRUPTIONS = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT") if hasattr(signal, name)]
