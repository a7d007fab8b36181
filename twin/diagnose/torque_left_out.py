"""Every run of a log left out in turn: whether an answer predicts runs that it was not fitted to.

As for the postures of a hammer test (:mod:`twin.diagnose.left_out`): what a faint thing shows in the one run that was
kept aside may be less than noise there.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from twin.diagnose.left_out import LeftOut
from twin.diagnose.records import LogRecord, Stage
from twin.diagnose.torque_fit import base_fit, evaluate
from twin.diagnose.torque_judge import Judge
from twin.diagnose.torque_search import Search
from twin.diagnose.torque_step import freed_by, with_entries
from twin.diagnose.torque_system import System, extended, refer, relinearised, with_wider
from twin.model.torque_base import base_of
from twin.model.torque_signal import Prepared, Run
from twin.parallel import spread


def left_out_runs(
    prepared: Prepared,
    search: Search,
    records_of: Callable[[Prepared, Search], list[LogRecord]],
    error_of: Callable[[list[LogRecord], Stage], float | None],
    processes: int,
) -> LeftOut | None:
    """Every run used left out in turn, and those that were kept aside; ``None`` where that is one run, or a law.

    Args:
        records_of: every run beside the models of a search.
        error_of: the error of records that were not used.
    """
    runs = [*prepared.used]
    if len({run.name for run in runs}) < len(runs) or len(runs) < 2 or search.law or search.narrow != 1.0:
        return None

    def fold(number: int) -> list[LogRecord]:
        rest = replace(prepared, used=[run for k, run in enumerate(runs) if k != number], kept=[runs[number]])
        return [r for r in records_of(rest, without_run(search, rest)) if r.held_out]

    records = [r for some in spread(fold, len(runs), processes) for r in some]
    records += [r for r in records_of(prepared, search) if r.held_out]
    before, after = error_of(records, "before"), error_of(records, "after")
    if before is None or after is None:
        return None
    gain = 0.5 * sum(r.energy("before") - r.energy("after") for r in records)
    return LeftOut(tuple(r.name for r in records), (before, after), float(gain))


def without_run(search: Search, rest: Prepared) -> Search:
    """A search with what was found fitted to fewer runs, from where it is."""
    plain = _on(search.plain, rest.used)
    if search.resized:
        plain = relinearised(with_wider(plain, search.resized))
    system = plain = with_entries(plain, search.plain, search.plain.found)
    for suspect in search.system.found[len(plain.found) :]:
        system = extended(system, evaluate(system, suspect, search.system.z[search.system.own(suspect)]))
    for step in search.found:
        system = with_wider(system, freed_by(system, step))
    system = relinearised(system)
    first = replace(search.first, base=base_fit(plain))
    return replace(
        search, plain=plain, system=system, after=base_fit(system), first=first, judge=Judge(plain, rest.kept)
    )


def _on(system: System, runs: list[Run]) -> System:
    """The base model of a system on other runs, whitened alike."""
    base = base_of(system.base.regressor, runs, system.base.sliding)
    bare = System(base, system.whitening, base.parameters, level=system.level, noise=system.noise)
    refer(bare, np.zeros(len(base.parameters)))
    bare.assemble()
    refer(bare, bare.z)
    return bare
