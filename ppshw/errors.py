"""Every error this project raises, drawn where it is defined.

    PpshwError                 exit code 1: the run failed
    ├── BadInput               exit code 2: what was given cannot be used
    │   ├── MachineFileError
    │   ├── RecordingError
    │   ├── CampaignError
    │   ├── CalibrationError
    │   ├── SiteError
    │   ├── ReportError
    │   └── CompensationRefused
    ├── IdentificationFailed   the data do not determine what was asked
    ├── RunFailed              a visit cannot be carried out as asked, in the middle of a campaign
    ├── Stopped                the operator stopped the run
    ├── SealBroken             a truth is not the one whose hash was published before the diagnosis
    └── HardwareError          a device and the cause
        ├── DriveFault             the drive reports a fault
        ├── FollowingError         an axis is not where it was sent
        ├── SoftLimit              a setpoint outside the axis' limits
        ├── HeartbeatLost          a node fell silent
        ├── BusLost                the CAN bus or its adapter is gone
        │   └── BusTaken           or another program's
        ├── LineLost               a serial line or its adapter is gone
        ├── HardwareTimeout        a device answers, but not in time
        ├── IdentityMismatch       another device than the site file says
        ├── ConfigurationMismatch  a value written was not the value read back
        ├── BeamLost               the tracker finds no target
        ├── InstrumentFault        the instrument reports an error of its own
        ├── SensorOverrange        the load is outside the force sensor's range
        └── ProtocolError          what came over the line is not what the protocol says

An error says who, what and how much in one line; the command line prints that line and nothing else.
"""

from __future__ import annotations


class PpshwError(Exception):
    """Root of the tree. `exit_code` is what the command line returns."""

    exit_code = 1


class BadInput(PpshwError):
    """Something given by the user cannot be used: what, where, and what was expected."""

    exit_code = 2


class MachineFileError(BadInput):
    pass


class RecordingError(BadInput):
    pass


class CampaignError(BadInput):
    pass


class CalibrationError(BadInput):
    pass


class SiteError(BadInput):
    pass


class ReportError(BadInput):
    """A folder that holds nothing, or nothing whole, to report on."""


class CompensationRefused(BadInput):
    """A wanted pose, load or correction outside what may be compensated; nothing is clipped in silence."""


class IdentificationFailed(PpshwError):
    pass


class RunFailed(PpshwError):
    """What would have been bad input before the run shows in the middle of it, when visits are in the recording; or the
    recording takes no more (a full disk)."""


class Stopped(PpshwError):
    """The operator stopped the run; everything measured so far is in the recording."""


class SealBroken(PpshwError):
    """The truth is not the one whose hash was published before the diagnosis."""


class HardwareError(PpshwError):
    """A device and the cause. `str()` gives "device: cause"."""

    def __init__(self, device: str, cause: str) -> None:
        super().__init__(f"{device}: {cause}")
        self.device = device
        self.cause = cause


class DriveFault(HardwareError):
    pass


class FollowingError(HardwareError):
    pass


class SoftLimit(HardwareError):
    pass


class HeartbeatLost(HardwareError):
    pass


class BusLost(HardwareError):
    pass


class BusTaken(BusLost):
    pass


class LineLost(HardwareError):
    pass


class HardwareTimeout(HardwareError):
    pass


class IdentityMismatch(HardwareError):
    pass


class ConfigurationMismatch(HardwareError):
    pass


class BeamLost(HardwareError):
    pass


class InstrumentFault(HardwareError):
    pass


class SensorOverrange(HardwareError):
    pass


class ProtocolError(HardwareError):
    pass
