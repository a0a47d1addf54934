"""`ppshw prove`: concealed cases are generated, sealed, diagnosed, opened, scored; a table says how often it was right.

Cases run on the studies' engine (a local cluster, or a scheduler whose workers see DIR) and each leaves its score in a
file. A worker that dies costs its case at most, and the same command again goes on where it stopped. The generator is
another program (`python -m simulators.concealed`): nothing of it is imported here, and what it sealed is not read
before the answer lies on disk.

    DIR/cases/NAME/    machine.yaml, recording.csv, held_out.csv, seal.sha256     what the diagnosis is given
    DIR/seals.txt      the hashes, written before any diagnosis
    DIR/answers/NAME/  answer.json, calibration.json                              what it said
    DIR/sealed/NAME/   truth.json                                                 opened after that
    DIR/scores/NAME.json, DIR/prove.json, DIR/prove.md, DIR/prove.html
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ppshw.errors import BadInput, PpshwError, SealBroken
from ppshw.prove.score import Json, judge, open_seal, read_answer, score_case
from ppshw.prove.table import summarise
from ppshw.studies.engine import Cluster, Job, run_jobs
from ppshw.whole_file import write_text

# What an answer needs: (case folder, answer folder) → the contract's JSON; it may leave calibration.json there.
# A third argument takes a name out of the library, for cases that ask for it.
Diagnoser = Callable[..., Json]
Say = Callable[[str, int, int], None]
TIME_LIMIT_S = 900.0
SEALS = "seals.txt"
EFFECTS = (
    "backlash", "friction_hysteresis", "thermal_growth", "drift", "tracker_scale", "periodic_transmission",
    "nonlinear_stiffness", "clearance", "cross_coupling", "moving_weight", "wrench_error", "creep", "zero_shift",
    "missing_compliance", "target_moved", "outliers", "unsettled",
)  # fmt: skip
SIZES = (0.3, 0.5, 1.0, 2.0)


@dataclass(frozen=True)
class Spec:
    """One case to be made: the generator's arguments. fit = visits leaves nothing held out, and no gain to score.

    without  a name that is taken out of the library before the diagnosis; "" for none
    """

    seed: int
    machine: str
    effect: str
    size: float
    visits: int = 600
    fit: int = 450
    without: str = ""

    @property
    def name(self) -> str:
        """A number; whoever knows how a deck is shuffled knows its effect and size, not where it sits nor its form."""
        return f"{self.seed}"

    def command(self, case: Path, sealed: Path) -> list[str]:
        return [
            sys.executable, "-m", "simulators.concealed", "--seed", str(self.seed), "--machine", self.machine,
            "--effect", self.effect, "--size", str(self.size), "--visits", str(self.visits),
            "--fit", str(self.fit),
            "--out", str(case), "--sealed", str(sealed),
        ]  # fmt: skip


def deck(count: int, seed: int) -> list[Spec]:
    """The first `count` cards of an endless shuffled deck; the same for the same seed, however many are asked for.

    One round: every effect at every size, 20 nulls, 12 pairs and 8 unknown effects at the repeatability's size; a
    quarter of it on an arm.
    """
    rng = np.random.default_rng([seed, 4])
    cards: list[Spec] = []
    while len(cards) < count:
        one = [(effect, size) for effect in EFFECTS for size in SIZES]
        one += [("null", 0.0)] * 20 + [("pair", 1.0)] * 12 + [("unknown", 1.0)] * 8
        for k in rng.permutation(len(one)):
            machine = "arm6" if rng.random() < 0.25 else "pps"
            effect, size = one[k]
            cards.append(Spec(1000 * seed + len(cards), machine, effect, size))
    return cards[:count]


def removed_deck(count: int, seed: int) -> list[Spec]:
    """Effects of the repeatability's size that the diagnosis is not to know: what other names does it give them?

    Seeds begin at 1000·seed + 600, beyond those of a deck. Outliers are no class of the library.
    """
    rng = np.random.default_rng([seed, 6])
    effects = [e for e in EFFECTS if e != "outliers"]
    cards: list[Spec] = []
    while len(cards) < count:
        for k in rng.permutation(len(effects)):
            machine = "arm6" if rng.random() < 0.25 else "pps"
            cards.append(Spec(1000 * seed + 600 + len(cards), machine, effects[k], 1.0, without=effects[k]))
    return cards[:count]


def short_deck(seed: int) -> list[Spec]:
    """A dozen short campaigns: two nulls, clear marks at twice the repeatability, a pair, a stranger."""
    clear = ("backlash", "friction_hysteresis", "thermal_growth", "periodic_transmission", "clearance", "zero_shift",
             "target_moved", "tracker_scale")  # fmt: skip
    cards = [("pps", "null", 0.0), ("arm6", "null", 0.0), *(("pps", effect, 2.0) for effect in clear),
             ("pps", "pair", 1.0), ("pps", "unknown", 1.0)]  # fmt: skip
    return [Spec(1000 * seed + k, *card, 300, 225) for k, card in enumerate(cards)]


def run_prove(
    out: Path,
    cases: Sequence[Spec],
    diagnoser: Diagnoser | None = None,
    workers: int = 2,
    scheduler: str | None = None,
    say: Say = lambda name, done, total: None,
) -> Json:
    """Run all cases that have no score yet and write the table; returns what prove.json holds.

    diagnoser  `ppshw diagnose` by default; must be importable by name, since it runs in another process
    workers    processes at a time; 0: all in this one, for tests and debuggers
    scheduler  of a dask cluster instead, whose workers see `out` under the same path
    Raises BadInput, before anything is written, for two cases of one seed, another address than a scheduler's, and
    scores or seals in `out` that are damaged.
    """
    out, cluster = out.resolve(), Cluster(workers, scheduler)  # a worker's folder is another
    if len({spec.name for spec in cases}) < len(cases):
        raise BadInput(f"{out}: two cases of one seed, expected each once")
    for spec in cases:
        if (there := out / "scores" / f"{spec.name}.json").exists():
            _score(there)
    _published(out)
    for folder in ("cases", "answers", "sealed", "scores"):
        (out / folder).mkdir(parents=True, exist_ok=True)
    task = partial(_case, diagnoser=diagnoser or ppshw_diagnose)
    jobs = [Job(spec.name, {"out": str(out), "spec": asdict(spec)}) for spec in cases]
    lost = run_jobs(task, jobs, cluster=cluster, say=lambda done, total: say("prove", done, total)).lost
    seals, broken = _published(out), []
    for spec in cases:  # also of a case whose score lay there: a truth may be touched later
        if spec.name in lost and spec.name not in seals:
            continue
        try:
            truth = open_seal(seals.get(spec.name, ""), out / "sealed" / spec.name)
            if spec.name not in lost:
                _agrees(out / "scores" / f"{spec.name}.json", truth, out / "answers" / spec.name / "answer.json")
        except SealBroken as exc:
            lost[spec.name] = "; ".join([*filter(None, [lost.get(spec.name)]), str(exc)])
            broken.append(spec.name)
    scores = [_score(out / "scores" / f"{s.name}.json") for s in cases if s.name not in lost]
    # an earlier program, whose scores are taken up, may have judged by other rules
    scores = [{**s, **judge(s["truth"], s["answer"])} for s in scores]
    document = {"cases": len(cases), "lost": lost, "broken": broken, **summarise(scores)}
    from ppshw.prove.page import write_page  # pictures: no worker draws one

    write_text(out / "prove.json", json.dumps(document, indent=1))
    write_page(out, document, [s for s in scores if not s["spec"]["without"]])
    return document


def _case(out: str, spec: Json, diagnoser: Diagnoser) -> Json:
    """A case as the engine's job; its scores are files, and so its journal."""
    return {"score": str(run_case(Path(out), Spec(**spec), diagnoser))}


def run_case(out: Path, spec: Spec, diagnoser: Diagnoser) -> Path:
    """Generate, publish the seal, diagnose, open, score: the whole life of one case. Returns its score's file."""
    score = out / "scores" / f"{spec.name}.json"
    if score.exists():
        if _score(score)["spec"] != asdict(spec):
            raise BadInput(f"{score}: the score of another case, expected {asdict(spec)}")
        return score
    case, answers, sealed = (out / part / spec.name for part in ("cases", "answers", "sealed"))
    made = _run(spec.command(case, sealed))
    if made.returncode != 0:
        raise BadInput(f"{made.stderr.strip() or f'the generator ended with {made.returncode}'}")
    seal = made.stdout.strip()
    with (out / SEALS).open("a", encoding="utf-8") as file:  # one short line: appended whole
        file.write(f"{spec.name} {seal} {time.strftime('%Y-%m-%dT%H:%M:%SZ', time.gmtime())}\n")
    answers.mkdir(parents=True, exist_ok=True)
    began = time.perf_counter()
    answer = diagnoser(case, answers, spec.without) if spec.without else diagnoser(case, answers)
    seconds = time.perf_counter() - began
    write_text(answers / "answer.json", json.dumps(answer, indent=1))
    found = score_case(case, sealed, seal, answer, answers / "calibration.json", seconds)
    write_text(score, json.dumps({"spec": asdict(spec), **found}, indent=1))
    return score


def _score(file: Path) -> Json:
    """What lies in a score's file. Raises BadInput where it is none."""
    with suppress(ValueError):
        found = json.loads(file.read_text(encoding="utf-8"))
        if isinstance(found, dict) and {"spec", "truth", "answer"} <= found.keys():
            return found
    raise BadInput(f"{file}: damaged, expected the score of a case; without the file the case is run again")


def _agrees(file: Path, truth: Json, answer: Path) -> None:
    """Raises SealBroken where a score's file tells of another truth than was sealed, or of another answer than lies
    beside the case; its figures are what was worked out of both."""
    score, sealed = _score(file), [{k: v for k, v in e.items() if k != "field_nm"} for e in truth["effects"]]
    told = [{k: v for k, v in e.items() if k in of} for e, of in zip(score["truth"], sealed, strict=False)]
    if told != sealed or len(score["truth"]) != len(sealed):
        raise SealBroken(f"{file}: tells of another truth than was sealed")
    if read_answer(answer) != score["answer"]:
        raise SealBroken(f"{file}: tells of another answer than {answer}")


def _published(out: Path) -> dict[str, str]:
    """Case → the hash that was published last of its truth. Raises BadInput for another line than `run_case` writes."""
    file = out / SEALS
    found: dict[str, str] = {}
    for k, line in enumerate(file.read_text(encoding="utf-8").splitlines() if file.exists() else [], start=1):
        if len(words := line.split()) != 3:
            raise BadInput(f"{file}:{k}: '{line}', expected a case, the hash of its truth and when it was published")
        found[words[0]] = words[1]
    return found


def ppshw_diagnose(case: Path, answers: Path, without: str = "") -> Json:
    """The command itself, as a user would run it, on what is in the case's folder."""
    said = answers / "said.json"
    command = [
        sys.executable, "-m", "ppshw", "diagnose", str(case / "recording.csv"), "--machine",
        str(case / "machine.yaml"), "--json", str(said), "--out", str(answers / "calibration.json"),
    ]  # fmt: skip
    run = _run([*command, "--without", without] if without else command)
    if run.returncode != 0:
        raise PpshwError(f"diagnose ended with {run.returncode}: {run.stderr.strip()}")
    return read_answer(said)


def _run(command: Sequence[str]) -> subprocess.CompletedProcess[str]:
    """Another program's run; it must not take longer than a case may."""
    try:
        return subprocess.run(command, capture_output=True, text=True, check=False, timeout=TIME_LIMIT_S)
    except subprocess.TimeoutExpired:
        raise PpshwError(f"stopped after {TIME_LIMIT_S:g} s") from None


def sentences(document: dict[str, Any]) -> str:
    """What the command prints."""
    lines = [f"{document['cases']} cases, {len(document['lost'])} lost"]
    lines += [f"  case {name}: {why}" for name, why in document["lost"].items()]
    for bar in document["bars"]:
        one = f"  {bar['met']:4} {bar['what']}: {bar['text']}"
        lines += [one] if len(one) <= 80 else [f"  {bar['met']:4} {bar['what']}", f"       {bar['text']}"]
    return "\n".join(lines)
