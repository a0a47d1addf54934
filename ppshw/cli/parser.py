"""What may be said on the command line: every command, its options, and the function that does it."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import Any, NoReturn

from ppshw import __version__
from ppshw.cli.arguments import count, length, positive, seed, share, whole
from ppshw.cli.diagnosing import diagnose, report, twin
from ppshw.cli.fit import evaluate, identify
from ppshw.cli.planning import plan
from ppshw.cli.recordings import export, import_
from ppshw.cli.setpoints import NO_LOAD, compensate, move
from ppshw.cli.simulated import demo, simulate
from ppshw.cli.site import ANGLES, check, run, station
from ppshw.cli.studies import prove, study


class _Help(argparse.HelpFormatter):
    """Several words of one option as their metavar says them, which may be given as one word too: no `[... ...]`."""

    def _format_args(self, action: argparse.Action, default_metavar: str) -> str:
        if action.nargs == "+" and isinstance(action.metavar, str):
            return action.metavar
        return super()._format_args(action, default_metavar)


class _Parser(argparse.ArgumentParser):
    """Complaints in one line, like every other."""

    def __init__(self, **named: Any) -> None:
        super().__init__(formatter_class=_Help, **named)

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: {' '.join(message.split())} (see {self.prog} --help)\n")


Add = Callable[..., argparse.ArgumentParser]


def build_parser() -> argparse.ArgumentParser:
    parser = _Parser(prog="ppshw", description="Measure, identify and take out the errors of a large manipulator.")
    parser.add_argument("--version", action="version", version=f"ppshw {__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND", parser_class=_Parser)

    def add(
        name: str, function: Callable[[argparse.Namespace], None], about: str, json: bool = True
    ) -> argparse.ArgumentParser:
        found = commands.add_parser(name, help=about, description=f"{about[0].upper()}{about[1:]}.")
        if json:
            found.add_argument("--json", action="store_true", help="print the answer as JSON")
        found.set_defaults(function=function)
        return found

    # in the order of the help
    for some in (_simulation, _campaigns, _recordings, _calibrations, _setpoints, _diagnosis, _studies):
        some(add)
    return parser


def _simulation(add: Add) -> None:
    p = add("demo", demo, "the main job on simulated hardware, from campaign to compensated verification")
    p.add_argument("--out", default="demo-out", metavar="DIR",
                   help="where results go, in place of an earlier demo's (default: demo-out)")  # fmt: skip
    p.add_argument("--seed", type=seed, default=1, help="seed of the simulated machine (default: 1)")
    p.add_argument("--machine", default="pps", metavar="M", help="machine file (default: pps, the positioner)")
    p.add_argument("--method", choices=("joint", "paper"), default="joint", help="identification (default: joint)")
    p.add_argument(
        "--conceal",
        type=seed,
        metavar="SEED",
        help="instead: the machine hides an effect that this seed picks, to be found, named and taken out",
    )

    p = add("simulate", simulate, "simulated hardware as a process of its own, on endpoints that open like real ones")
    _machine(p)
    p.add_argument("--site-out", required=True, metavar="S", help="site file to write, for check and run")
    p.add_argument("--seed", type=seed, default=1, help="seed of the simulated machine (default: 1)")
    p.add_argument("--speed", type=positive, default=1.0, help="how much faster than real time (default: 1)")
    p.add_argument("--force-sensor", choices=("bota", "gsv8"), default="bota")


def _campaigns(add: Add) -> None:
    p = add("check", check, "connect to each device of a site and say who and how it is; moves nothing")
    p.add_argument("--site", required=True, metavar="S", help="site file")

    p = add("station", station, "where the tracker stands, from what it read of three or more reflectors")
    _machine(p)
    p.add_argument("--joints", nargs="+", required=True, metavar="Q1 … QN", help="joint values there, as check prints "
                   "them [m, rad]")  # fmt: skip
    p.add_argument(
        "--read",
        nargs="+",
        action="extend",
        required=True,
        metavar="R1=HZ,V,DISTANCE",
        help="of every reflector: horizontal circle, vertical circle from the zenith, slope distance [m]",
    )
    p.add_argument("--angles", choices=tuple(ANGLES), default="gon", help="unit of the circles (default: gon)")

    p = add("plan", plan, "expand a campaign, check it against limits, say how many visits and how long; or design one")
    p.add_argument("campaign", nargs="?", help="campaign script (a file, or the name of one that comes with ppshw)")
    _machine(p)
    p.add_argument("--list", action="store_true", help="list every visit")
    p.add_argument("--visibility", action="store_true", help="for every effect and joint what the campaign would show")
    p.add_argument("--to-separate", metavar="A,B", help="visits that tell two effects apart, after this or --after")
    p.add_argument("--joint", metavar="J", help="with --to-separate: at this joint only (default: at every joint)")
    g = p.add_argument_group("design of a new campaign: what to measure for the least error at a point")
    g.add_argument("--visits", type=count, metavar="N", help="of that many visits, reference visits counted")
    g.add_argument("--accuracy", type=length, metavar="X", help="with this predicted 98.6 %%, noise included: 0.25mm")
    g.add_argument("--after", metavar="REC", help="go on after this recording: what to measure next, when to stop")
    g.add_argument("--out", metavar="CAMPAIGN.yaml", help="the script to write")
    g.add_argument("--calibration", metavar="CAL.json", help="believe the prior strengths and the noise learnt there")
    g.add_argument("--loads", metavar="SCRIPT", help="only load cases of this script (default: those of --after or of "
                   "the campaign; else 20 to 200 kg, or less)")  # fmt: skip
    g.add_argument("--load-cases", type=count, metavar="K", help="how many loads to put on (default: 4)")
    g.add_argument("--point", help="where accuracy counts (default: treatment, else the first point, or the tip)")
    g.add_argument("--seed", type=seed, help="of everything random (default: 1)")

    p = add("run", run, "run a campaign; the same command again goes on where it stopped")
    p.add_argument("campaign", help="campaign script (a file, or the name of one that comes with ppshw)")
    p.add_argument("--site", required=True, metavar="S", help="site file")
    p.add_argument("--out", required=True, metavar="REC.db", help="the recording; goes on with one that is begun")
    p.add_argument("--calibration", metavar="CAL.json", help="drive compensated setpoints")
    p.add_argument("--after", metavar="REC", help="what was measured last before: creep, friction and lags go on from "
                   "there (default: from the calibration's recording, if that ended within an hour)")  # fmt: skip
    p.add_argument("--point", help="with fewer than six joints: what they bring to its place (default: treatment, else "
                   "the first point, or the tip)")  # fmt: skip
    _reset_faults(p)


def _recordings(add: Add) -> None:
    p = add("import", import_, "interchange CSV → recording, lossless")
    p.add_argument("csv", metavar="CSV")
    _machine(p)
    p.add_argument("--out", required=True, metavar="REC.db", help="a new file")

    p = add("export", export, "recording → interchange CSV, lossless")
    p.add_argument("rec", metavar="REC.db")
    p.add_argument("csv", metavar="CSV")


def _calibrations(add: Add) -> None:
    p = add("identify", identify, "a recording → a calibration with its uncertainty")
    p.add_argument("rec", metavar="REC", help="recording, .db or .csv")
    _machine(p)
    p.add_argument("--out", required=True, metavar="CAL.json")
    p.add_argument("--method", choices=("joint", "paper"), default="joint",
                   help="joint: all visits at once; paper: stepwise, needs the paper's campaign")  # fmt: skip

    p = add("evaluate", evaluate, "what the model misses on a recording it has not seen")
    p.add_argument("rec", metavar="REC", help="recording, .db or .csv")
    _machine(p)
    p.add_argument("--calibration", metavar="CAL.json", help="without: the ideal machine only")
    p.add_argument("--refit-base", action="store_true",
                   help="the tracker was moved since the calibration: fit the measuring frame to this recording first "
                   "(default: the frame of the calibration, or of the machine file)")  # fmt: skip


def _setpoints(add: Add) -> None:
    for name, function, about in (
        ("compensate", compensate, "wanted pose and load → corrected joint setpoints; without --site moves nothing"),
        ("move", move, "the same as compensate, and drives the axes there"),
    ):
        p = add(name, function, about)
        _machine(p)
        p.add_argument("--calibration", required=True, metavar="CAL.json")
        wanted = p.add_mutually_exclusive_group(required=True)
        wanted.add_argument("--pose", nargs="+", metavar="X Y Z ROLL PITCH YAW",
                            help="of the point, in the base frame [m, rad]")  # fmt: skip
        wanted.add_argument("--joints", nargs="+", metavar="Q1 … QN",
                            help="instead: the pose that the ideal machine has there [m, rad]")  # fmt: skip
        p.add_argument("--wrench", nargs="+", default=NO_LOAD, metavar="FX FY FZ MX MY MZ",
                       help="payload on the sensor at that pose, sensor frame [N, N m] (default: none)")  # fmt: skip
        p.add_argument("--point", default="tip", help="tip, or a point or target of the machine file (default: tip)")
        p.add_argument("--near", nargs="+", metavar="Q1 … QN",
                       help="of several ways to reach the pose, the one nearest to this")  # fmt: skip
        p.add_argument("--max-travel", type=positive, default=0.03, metavar="M",
                       help="most that a prismatic joint may be corrected (default: 0.03)")  # fmt: skip
        p.add_argument("--max-angle", type=positive, default=0.03, metavar="RAD",
                       help="most that a revolute joint may be corrected (default: 0.03)")  # fmt: skip
        p.add_argument("--max-beyond", type=share, metavar="SHARE",
                       help="how far a joint or a load may lie beyond what was identified, as a share of that range "
                       "(default: 0.05 for joints, 0.1 for loads)")  # fmt: skip
        p.add_argument("--from", dest="start", nargs="+", metavar="Q1 … QN",
                       help="joint values that the move starts from: they tell the directions of approach")  # fmt: skip
        p.add_argument("--approach", nargs="+", action="extend", metavar="JOINT=+1 …",
                       help="direction of a joint's final motion")  # fmt: skip
        p.add_argument("--temperature", nargs="+", action="extend", metavar="PLACE=21.5 …",
                       help="of a place, by the recording's name for it [°C]")  # fmt: skip
        p.add_argument("--loaded-for", type=positive, metavar="S", help="how long the load has been on [s]")
        p.add_argument("--lay-before", nargs="+", metavar="FX … MZ",
                       help="what the sensor read there before the load was put on; zeros: nothing")  # fmt: skip
        p.add_argument("--site", required=name == "move", metavar="S", help="site file of the axes to drive there")
        _reset_faults(p)


def _diagnosis(add: Add) -> None:
    p = add("report", report, "one self-contained HTML page of what a folder holds")
    p.add_argument("dir", metavar="DIR",
                   help="machine.yaml, and what there is of calibration.json, campaign.db (or the recording that the "
                   "calibration was made from), diagnosis.json, verification_nominal.db, verification_compensated.db, "
                   "repeatability.db, demo.json; of a demo --conceal also verification_base.db, "
                   "verification_extended.db, extended.json, concealed.json. Recordings may be .csv instead of "
                   ".db")  # fmt: skip

    about = "locate, name and model what the model leaves unexplained in a recording"
    p = add("diagnose", diagnose, about, json=False)
    p.add_argument("rec", metavar="REC", help="recording, .db or .csv")
    _machine(p)
    p.add_argument("--json", nargs="?", const="-", metavar="OUT.json",
                   help="the answer as JSON, into a file; without one printed instead of the sentences")  # fmt: skip
    p.add_argument("--out", metavar="CAL.json", help="a calibration with what was found modelled")
    p.add_argument("--page", metavar="OUT.html", help="a page with pictures: where it sits, what was found, how sure")
    p.add_argument("--without", nargs="+", default=[], metavar="NAME …", help="effects that are not to be thought of")

    p = add("twin", twin, "what a calibration says the visits of a recording would have read, and whether they did")
    p.add_argument("rec", metavar="REC", help="recording, .db or .csv")
    _machine(p)
    p.add_argument("--calibration", required=True, metavar="CAL.json", help="with its effects, if it has any")
    p.add_argument("--out", required=True, metavar="TWIN.csv", help="the recording with simulated readings")
    p.add_argument("--seed", type=seed, default=0, help="of its noise (default: 0)")


def _studies(add: Add) -> None:
    p = add("prove", prove, "how often is a diagnosis right: concealed cases, sealed, diagnosed, opened, scored")
    p.add_argument("--out", required=True, metavar="DIR")
    p.add_argument("--cases", type=count, metavar="N", help="default: 108, the whole deck once")
    p.add_argument("--seed", type=seed, default=1)
    p.add_argument("--removed", type=whole, metavar="N",
                   help="N more whose effect's name is taken out of the library (default: 0)")  # fmt: skip
    p.add_argument("--short", action="store_true", help="a dozen short campaigns instead")
    _cluster(p)

    p = add("study", study, "the paper's studies over many simulated machines: a table and a picture each")
    p.add_argument("study", metavar="STUDY", choices=STUDIES, help=", ".join(STUDIES))
    p.add_argument("--out", required=True, metavar="DIR", help="goes on with what an earlier call left there")
    p.add_argument("--seeds", type=count, metavar="N", help="machines (default: 20; residuals: 100; with --short: 1)")
    p.add_argument("--short", action="store_true", help="small and quick, to see that it runs")
    _cluster(p)


# Names of ppshw.studies.catalogue, which takes long to import.
STUDIES = ("accuracy-repeatability", "accuracy-visits", "residuals", "directions")


def _machine(p: argparse.ArgumentParser) -> None:
    p.add_argument("--machine", required=True, metavar="M", help="machine file, or pps or arm6, which come with it")


def _cluster(p: argparse.ArgumentParser) -> None:
    """Where the jobs of a study run: ppshw.studies.engine."""
    p.add_argument("--workers", type=whole, default=2, metavar="N",
                   help="processes at a time on this computer (default: 2; 0: this one, without dask)")  # fmt: skip
    p.add_argument("--scheduler", metavar="tcp://HOST:PORT", help="a running dask scheduler instead of processes here")


def _reset_faults(p: argparse.ArgumentParser) -> None:
    p.add_argument("--reset-faults", action="store_true",
                   help="acknowledge the drives' faults first: somebody has seen to the cause")  # fmt: skip
