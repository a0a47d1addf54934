"""ppshw: measure, identify and take out the geometric and elastic errors of a large manipulator."""

__version__ = "0.1.0"
