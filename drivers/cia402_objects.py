"""The words of CiA 402: objects with their types, states, controlword commands, and what a TPDO says.

No maker's EDS is needed: these objects have the standard's types in every drive.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass

import canopen
from canopen.objectdictionary import ODRecord, ODVariable, datatypes

from drivers.canopen_bus import Entry

ERROR_REGISTER = Entry(0x1001, 0, "B", "error register")
CONSUMER_HEARTBEAT = Entry(0x1016, 1, "I", "consumer heartbeat time")
PRODUCER_HEARTBEAT = Entry(0x1017, 0, "H", "producer heartbeat time")
VENDOR = Entry(0x1018, 1, "I", "vendor")
PRODUCT = Entry(0x1018, 2, "I", "product code")
REVISION = Entry(0x1018, 3, "I", "revision")
SERIAL = Entry(0x1018, 4, "I", "serial number")
ABORT_OPTION = Entry(0x6007, 0, "h", "abort connection option")
ERROR_CODE = Entry(0x603F, 0, "H", "error code")
CONTROLWORD = Entry(0x6040, 0, "H", "controlword")
STATUSWORD = Entry(0x6041, 0, "H", "statusword")
MODE = Entry(0x6060, 0, "b", "mode of operation")
MODE_DISPLAY = Entry(0x6061, 0, "b", "mode display")
QUICK_STOP_OPTION = Entry(0x605A, 0, "h", "quick stop option")
FAULT_OPTION = Entry(0x605E, 0, "h", "fault reaction option")
POSITION = Entry(0x6064, 0, "i", "position")
FOLLOWING_WINDOW = Entry(0x6065, 0, "I", "following error window")
FOLLOWING_TIME = Entry(0x6066, 0, "H", "following error time-out")
POSITION_WINDOW = Entry(0x6067, 0, "I", "position window")
POSITION_TIME = Entry(0x6068, 0, "H", "position window time")
TARGET = Entry(0x607A, 0, "i", "target position")
HOME_OFFSET = Entry(0x607C, 0, "i", "home offset")
LIMIT_LOW = Entry(0x607D, 1, "i", "lower position limit")
LIMIT_HIGH = Entry(0x607D, 2, "i", "upper position limit")
VELOCITY = Entry(0x6081, 0, "I", "profile velocity")
ACCELERATION = Entry(0x6083, 0, "I", "profile acceleration")
DECELERATION = Entry(0x6084, 0, "I", "profile deceleration")
HOMING_METHOD = Entry(0x6098, 0, "b", "homing method")
HOMING_FAST = Entry(0x6099, 1, "I", "homing speed to switch")
HOMING_SLOW = Entry(0x6099, 2, "I", "homing speed to zero")
HOMING_ACCELERATION = Entry(0x609A, 0, "I", "homing acceleration")

PROFILE_POSITION, HOMING = 1, 6
ABORT_BY_FAULT = 1  # abort connection option by which a drive whose host is lost does what it does at a fault
HOME_IN_PLACE = (35, 37)  # methods that take the present position for home, without a motion

DISABLE_VOLTAGE, QUICK_STOP, SHUTDOWN, SWITCH_ON, ENABLE, FAULT_RESET = 0x00, 0x02, 0x06, 0x07, 0x0F, 0x80
NEW_SET_POINT, CHANGE_AT_ONCE = 0x10, 0x20


class State(enum.Enum):
    NOT_READY_TO_SWITCH_ON = "NOT READY TO SWITCH ON"
    SWITCH_ON_DISABLED = "SWITCH ON DISABLED"
    READY_TO_SWITCH_ON = "READY TO SWITCH ON"
    SWITCHED_ON = "SWITCHED ON"
    OPERATION_ENABLED = "OPERATION ENABLED"
    QUICK_STOP_ACTIVE = "QUICK STOP ACTIVE"
    FAULT_REACTION_ACTIVE = "FAULT REACTION ACTIVE"
    FAULT = "FAULT"

    def __str__(self) -> str:
        return self.value


FAULTY = (State.FAULT_REACTION_ACTIVE, State.FAULT)  # the first leads to the second, by itself
STATUSWORD_PATTERNS = (  # mask, pattern, state: CiA 402-2, statusword coding
    (0x4F, 0x00, State.NOT_READY_TO_SWITCH_ON),
    (0x4F, 0x40, State.SWITCH_ON_DISABLED),
    (0x6F, 0x21, State.READY_TO_SWITCH_ON),
    (0x6F, 0x23, State.SWITCHED_ON),
    (0x6F, 0x27, State.OPERATION_ENABLED),
    (0x6F, 0x07, State.QUICK_STOP_ACTIVE),
    (0x4F, 0x0F, State.FAULT_REACTION_ACTIVE),
    (0x4F, 0x08, State.FAULT),
)
NEXT_COMMAND = {  # the way up to OPERATION ENABLED
    State.SWITCH_ON_DISABLED: SHUTDOWN,
    State.READY_TO_SWITCH_ON: SWITCH_ON,
    State.SWITCHED_ON: ENABLE,
    State.QUICK_STOP_ACTIVE: DISABLE_VOLTAGE,
}


def decode_state(statusword: int) -> State:
    for mask, pattern, state in STATUSWORD_PATTERNS:
        if statusword & mask == pattern:
            return state
    return State.NOT_READY_TO_SWITCH_ON  # no other pattern is defined


@dataclass(frozen=True)
class Snapshot:
    """What the last TPDO said. Before the first one there is none: a statusword of 0 would read as a state."""

    statusword: int
    counts: int
    mode: int

    @property
    def state(self) -> State:
        return decode_state(self.statusword)

    @property
    def target_reached(self) -> bool:
        return bool(self.statusword & 0x0400)

    @property
    def acknowledged(self) -> bool:
        """Set-point taken (mode 1), or home attained (mode 6)."""
        return bool(self.statusword & 0x1000)

    @property
    def off_course(self) -> bool:
        """Following error (mode 1), or homing error (mode 6)."""
        return bool(self.statusword & 0x2000)


def pdo_dictionary(node_id: int) -> canopen.ObjectDictionary:
    """The entries that canopen's PDO maps need, from the standard."""
    dictionary = canopen.ObjectDictionary()  # type: ignore[no-untyped-call]
    dictionary.node_id = node_id
    for entry, kind in (
        (CONTROLWORD, datatypes.UNSIGNED16),
        (STATUSWORD, datatypes.UNSIGNED16),
        (MODE, datatypes.INTEGER8),
        (MODE_DISPLAY, datatypes.INTEGER8),
        (POSITION, datatypes.INTEGER32),
        (TARGET, datatypes.INTEGER32),
    ):
        dictionary.add_object(_variable(entry.name, entry.index, 0, kind))
    for base in (0x1400, 0x1800):
        communication = ODRecord("PDO communication", base)
        communication.add_member(_variable("COB-ID", base, 1, datatypes.UNSIGNED32))
        communication.add_member(_variable("Transmission type", base, 2, datatypes.UNSIGNED8))
        dictionary.add_object(communication)
        mapping = ODRecord("PDO mapping", base + 0x200)
        mapping.add_member(_variable("Entries", base + 0x200, 0, datatypes.UNSIGNED8))
        for subindex in range(1, 9):
            mapping.add_member(_variable(f"Entry {subindex}", base + 0x200, subindex, datatypes.UNSIGNED32))
        dictionary.add_object(mapping)
    return dictionary


def _variable(name: str, index: int, subindex: int, kind: int) -> ODVariable:
    variable = ODVariable(name, index, subindex)
    variable.data_type = kind
    variable.access_type = "rw"
    return variable
