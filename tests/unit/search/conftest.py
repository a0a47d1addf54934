"""What a positioner with nothing wrong measured; made once per worker."""

from __future__ import annotations

import numpy as np
import pytest

from ppshw.diagnosis.workspace import Workspace, prepare
from tests.unit.clean_case import clean_case


@pytest.fixture(scope="session")
def space(tmp_path_factory: pytest.TempPathFactory) -> Workspace:
    machine, recording = clean_case(60533, "pps", 240, 180, tmp_path_factory.mktemp("clean"))
    return prepare(machine, recording, np.ones(len(recording), dtype=bool))
