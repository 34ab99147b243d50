"""`granjax bench`: error against time of many solvers on the canonical scenes, the quick ones first."""

import argparse
import contextlib
import json
import math
import sys
import threading
import time
from collections.abc import Iterator, Sequence

import granjax as gx

from ..checks import one_of, refuse, whole
from ..files import folder, target
from .output import UNREAD, complain, keep, say

ADVISED = (1e-2, 1e-4, 1e-6, 1e-8, 1e-10, 1e-12)
# seconds that a run without names of scenes may take, and share of them that it plans for
LIMIT, PLANNED = 120.0, 0.8
# of a scene, most of them for compiling ten solvers; other processes, and programs that are kept, change all alike
SECONDS = {
    "driven": 21, "monodromy": 25, "toda_soliton": 32, "impact": 33, "impact_free": 37, "softening": 38,
    "modulated": 41, "light_dimer": 53, "magnets": 55, "smooth": 120, "fput": 150, "dimer_sweep": 150,
    "toda_shock_1e4": 180, "toda_shock_1e5": 400,
}
OTHER = 35.0


def bench(arguments: argparse.Namespace) -> int:
    """Run the command; returns the exit code."""
    known = sorted(gx.canonical.names(), key=_seconds)
    if arguments.list:
        return say("\n".join(f"{name:<16}{_seconds(name):4.0f} s  {gx.canonical.scene(name).title}" for name in known))
    if arguments.all and arguments.scenes:
        refuse("SCENE", "names of scenes, or --all", "both")
    chosen = {one_of("SCENE", name, known) for name in arguments.scenes}
    names = [name for name in known if name in chosen] or known
    repeats, out = whole("--repeats", arguments.repeats, 1), folder("--out", arguments.out)
    places = {name: [target("--out", out / f"bench-{name}{end}") for end in (".json", ".png")] for name in names}
    clock = _Clock(names, math.inf if chosen or arguments.all else LIMIT)
    complain(clock.plan())
    done, code = {}, 0
    for name in names:
        if clock.is_late(name):
            complain(f"{clock.gone()} gone, and no time for {', '.join(names[names.index(name) :])}: --all, or names.")
            break
        scene = gx.canonical.scene(name)
        try:
            with clock.running(name):
                table = _measured(scene, repeats)
        except RuntimeError as error:
            code = complain(f"{name}: {error}", 1)
            continue
        done[name] = {"scene": name, "title": scene.title, "t0": scene.t0, "t1": scene.t1, **table.to_dict()}
        data, picture = places[name]
        code = keep(data, json.dumps(done[name], indent=1) + "\n") or code
        code = keep(picture, _chart(scene, table, picture.suffix)) or code
        if not arguments.json:
            said = say("\n".join([f"{name}: {scene.title}", str(table), *_advice(table), ""]))
            if said == UNREAD:
                return said
            code = code or said
    if arguments.json:
        code = say(json.dumps(done, allow_nan=False)) or code
    return code


def _seconds(name):
    return SECONDS.get(name, OTHER)


def _words(seconds):
    return f"{seconds:.0f} s" if seconds < 100 else f"{seconds / 60:.0f} min"


class _Clock:
    """How long scenes have taken, over what was expected of them, and so how long the others will."""

    def __init__(self, names: Sequence[str], limit: float):
        self.names, self.limit, self.begun, self.ended = list(names), limit, time.monotonic(), []

    def _elapsed(self):
        return time.monotonic() - self.begun

    def _pace(self):
        expected = sum(map(_seconds, self.ended))
        return self._elapsed() / expected if expected else 1.0

    def _coming(self):
        """Names of the scenes for which there is time, and the seconds that they will take; the first one always."""
        names, total, room = [], 0.0, self.limit - self._elapsed() if self.ended else PLANNED * self.limit
        for name in self.names[len(self.ended) :]:
            total += self._pace() * _seconds(name)
            if total > room and (names or self.ended):
                return names, total - self._pace() * _seconds(name)
            names.append(name)
        return names, total

    def plan(self) -> str:
        """What will be measured, and how long that takes."""
        names, total = self._coming()
        said = f"{len(names)} scene{'s' * (len(names) > 1)}, about {_words(total)}: {', '.join(names)}."
        rest = self.names[len(names) :]
        if rest:
            every = _words(sum(map(_seconds, self.names)))
            said += f" More if there is time; all {len(self.names)} take {every}: --all."
        return said

    def gone(self) -> str:
        """The time since the beginning."""
        return _words(self._elapsed())

    def is_late(self, name: str) -> bool:
        """Whether a scene would not end within the limit."""
        return name not in self._coming()[0]

    @contextlib.contextmanager
    def running(self, name: str) -> Iterator[None]:
        """Say what is measured and how long all of it takes; on a terminal each second anew."""
        names, total = self._coming()
        number, begun, over = len(self.ended) + 1, time.monotonic(), threading.Event()

        def line():
            left = max(total - (time.monotonic() - begun), 1.0)
            many = f"{name} ({number} of {len(self.ended) + len(names)})"
            return f"granjax: {many}, {self.gone()} gone, about {_words(left)} left"

        def tick():
            while not over.wait(1.0):
                with contextlib.suppress(OSError, ValueError):
                    print(f"\r{line()}   ", end="", file=sys.stderr, flush=True)

        shown = sys.stderr is not None and sys.stderr.isatty()
        thread = threading.Thread(target=tick, daemon=True) if shown else None
        complain(line().removeprefix("granjax: "))
        if thread:
            thread.start()
        try:
            yield
        finally:
            over.set()
            if thread:
                thread.join()
                with contextlib.suppress(OSError, ValueError):
                    print(file=sys.stderr, flush=True)
            self.ended.append(name)


def _measured(scene, repeats):
    return gx.work_precision(
        scene.lattice, scene.state, scene.t1, t0=scene.t0, repeats=repeats, tangents=scene.tangents,
        reference=scene.reference, uncertainty=None if scene.reference is None else scene.uncertainty,
    )


def _advice(table):
    reached = table.error[table.drawn].min(initial=math.inf)
    return [str(table.advice(error)) for error in ADVISED if error >= reached]


def _chart(scene, table, ending):
    with gx.plots.style():
        canvas = gx.plots.figure(10.5, 4.2)
        left, right = canvas.subplots(1, 2)
        gx.plots.work_precision(table, left).get_legend().remove()
        gx.plots.work_precision(table, right, against="evaluations")
        canvas.suptitle(scene.title, fontsize="medium")
        return gx.plots.drawn(canvas, ending)
