"""Many simulated machines, on a cluster if there is one: prove, study."""

from __future__ import annotations

import argparse
from pathlib import Path

from ppshw.cli.answers import say
from ppshw.errors import BadInput, PpshwError
from ppshw.progress import Bar


def prove(a: argparse.Namespace) -> None:
    from ppshw.prove import deck, removed_deck, run_prove, sentences, short_deck

    if a.short and (a.cases is not None or a.removed is not None):
        raise BadInput("prove: --short is a dozen cases of its own; --cases and --removed have no meaning with it")
    cases = short_deck(a.seed) if a.short else deck(a.cases or 108, a.seed) + removed_deck(a.removed or 0, a.seed)
    with Bar() as bar:
        answer = run_prove(Path(a.out), cases, workers=a.workers, scheduler=a.scheduler, say=bar)
    say(a, answer, f"{sentences(answer)}\npage {Path(a.out) / 'prove.html'}")
    if answer["broken"]:
        raise PpshwError(f"{a.out}: broken seals: {', '.join(answer['broken'])}: no truth to score by")
    if len(answer["lost"]) == answer["cases"]:
        raise PpshwError(f"{a.out}: every case was lost, the first: {next(iter(answer['lost'].values()))}")


def study(a: argparse.Namespace) -> None:
    from ppshw.studies.catalogue import STUDIES
    from ppshw.studies.engine import Cluster
    from ppshw.studies.study import aligned, run_study

    with Bar() as bar:
        answer = run_study(
            STUDIES[a.study], Path(a.out), a.seeds, a.short, Cluster(a.workers, a.scheduler),
            lambda done, total: bar(a.study, done, total),
        )  # fmt: skip
    lost = [f"lost: {key}: {why}" for key, why in answer["lost"].items()]
    say(a, answer, "\n".join([aligned(answer["rows"]), *lost, f"page {Path(a.out) / a.study}.md"]))
