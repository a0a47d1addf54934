"""All studies by name, for the command line."""

from __future__ import annotations

from ppshw.studies import accuracy, directions, residuals

STUDIES = {
    study.name: study
    for study in (accuracy.AGAINST_REPEATABILITY, accuracy.AGAINST_VISITS, residuals.STUDY, directions.STUDY)
}
