"""Good files, made once per worker; every test gets its own copy to spoil."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.contract.desk import copy_of, lay_out


@pytest.fixture(scope="session")
def good_files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return lay_out(tmp_path_factory.mktemp("desk"))


@pytest.fixture
def desk(good_files: Path, tmp_path: Path) -> Path:
    return copy_of(good_files, tmp_path)
