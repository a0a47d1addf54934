"""What a study is: jobs for the engine, a summary of their results, a picture; and the files that it leaves."""

from __future__ import annotations

import csv
import json
import textwrap
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ppshw.errors import BadInput, PpshwError
from ppshw.progress import COLUMNS
from ppshw.studies.engine import Cluster, Function, Job, Outcome, Say, run_jobs
from ppshw.studies.journal import code
from ppshw.whole_file import write_text

Json = dict[str, Any]
Rows = list[dict[str, Any]]
# Machines of the studies have seeds from here on; nothing was tuned on them.
FIRST_SEED = 4000


@dataclass(frozen=True)
class Study:
    """A study as a command.

    seeds      how many machines by default
    prepare    (folder, short, cluster) → what the jobs need that is the same for all of them
    jobs       (seeds, short, what was prepared) → jobs
    summarise  outcome → the table's rows, all with the same columns, and anything else for the JSON
    draw       outcome, rows, file → a picture there
    remarks    what a reader of the table must know
    """

    name: str
    about: str
    seeds: int
    function: Function
    prepare: Callable[[Path, bool, Cluster], Json]
    jobs: Callable[[Sequence[int], bool, Json], list[Job]]
    summarise: Callable[[Outcome], tuple[Rows, Json]]
    draw: Callable[[Outcome, Rows, Path], None]
    remarks: str


def nothing(out: Path, short: bool, cluster: Cluster) -> Json:
    """For studies whose jobs share nothing."""
    return {}


def run_study(
    study: Study, out: Path, seeds: int | None = None, short: bool = False, cluster: Cluster | None = None,
    say: Say | None = None,
) -> Json:  # fmt: skip
    """Run what is missing and write OUT/NAME.jsonl (as it goes), .json, .csv, .md and .png; returns what .json holds.

    Raises PpshwError when every job was lost.
    """
    if out.exists() and not out.is_dir():
        raise BadInput(f"{out}: exists and is no folder, expected a folder for the results")
    out.mkdir(parents=True, exist_ok=True)
    count = seeds if seeds is not None else (1 if short else study.seeds)
    cluster = cluster or Cluster()
    jobs = study.jobs(range(FIRST_SEED, FIRST_SEED + count), short, study.prepare(out, short, cluster))
    outcome = run_jobs(study.function, jobs, out / f"{study.name}.jsonl", cluster, say)
    if not outcome.results:
        raise PpshwError(f"{out}: every job was lost, the first: {next(iter(outcome.lost.values()))}")
    rows, more = study.summarise(outcome)
    times = list(outcome.seconds.values())
    document = {
        "study": study.name, "code": code(), "short": short, "visits": sorted({j.arguments["visits"] for j in jobs}),
        "first_seed": FIRST_SEED, "machines": count, "jobs": len(jobs),
        "seconds_per_job": round(sum(times) / len(times), 3), "lost": outcome.lost, "rows": rows, **more,
    }  # fmt: skip
    write_text(out / f"{study.name}.json", json.dumps(document, indent=1))
    with (out / f"{study.name}.csv").open("w", encoding="utf-8", newline="") as file:
        table = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        table.writeheader()
        table.writerows(rows)
    write_text(out / f"{study.name}.md", page(study, document))
    study.draw(outcome, rows, out / f"{study.name}.png")
    return document


def page(study: Study, document: Json) -> str:
    fewest, most = document["visits"][0], document["visits"][-1]
    campaigns = "The short version of the study (`--short`): campaigns" if document["short"] else "Campaigns"
    visits = f"{most}" if fewest == most else f"{fewest} to {most}"
    last = document["first_seed"] + document["machines"] - 1
    lines = [
        f"# {study.name}", "", f"{study.about[0].upper()}{study.about[1:]}.", "",
        f"{campaigns} of {visits} visits. {document['machines']} machines, seeds {document['first_seed']} to {last}; "
        f"{document['jobs']} jobs of {document['seconds_per_job']:.2f} s; {len(document['lost'])} lost. "
        f"{study.remarks}", "",
        table(document["rows"]), "", f"![{study.name}]({study.name}.png)", "",
    ]  # fmt: skip
    lines += [f"- lost: {key}: {why}" for key, why in document["lost"].items()]
    return "\n".join(lines)


def table(rows: Rows) -> str:
    """Markdown; three decimals, nothing where there is nothing."""
    lines = [list(rows[0]), ["---"] * len(rows[0])]
    lines += [[_cell(value) for value in row.values()] for row in rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def aligned(rows: Rows) -> str:
    """For a terminal: columns side by side, headers over as many lines as they need. What is the same in every row is
    said once, below."""
    alike = [key for key in rows[0] if len(rows) > 1 and len({_cell(row[key]) for row in rows}) == 1]
    keys = [key for key in rows[0] if key not in alike]
    cells = {key: [_cell(row[key]) for row in rows] for key in keys}
    wide = {key: max(map(len, (*cells[key], *key.split()))) for key in keys}
    words = {key: textwrap.wrap(key, wide[key]) for key in keys}
    left = {key for key in keys if any(isinstance(row[key], str) for row in rows)}
    gap = "  " if sum(wide.values()) + 2 * (len(keys) - 1) <= COLUMNS else " "
    height = max(map(len, words.values()), default=0)
    heads = {key: [""] * (height - len(words[key])) + words[key] for key in keys}
    columns = [[f"{text:{'<' if key in left else '>'}{wide[key]}}" for text in heads[key] + cells[key]] for key in keys]
    lines = map(gap.join, zip(*columns, strict=True))
    said = "in every row: " + ", ".join(f"{key} {_cell(rows[0][key])}" for key in alike)
    return "\n".join([*(line.rstrip() for line in lines), *(textwrap.wrap(said, COLUMNS) if alike else [])])


def _cell(value: Any) -> str:
    if value is None:
        return ""
    return f"{value:.3f}" if isinstance(value, float) else str(value)
