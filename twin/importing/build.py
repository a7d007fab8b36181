"""Tables and a map become what the twin reads: a motion log, or a hammer test."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

from twin.errors import InputError, tell
from twin.importing.guess import clocks
from twin.importing.map import FunctionsMap, HitsMap, LogMap, Sensor, Stance, Struck, Taken, UniversalMap
from twin.importing.tables import Table, chosen, joined
from twin.measure.campaign import Campaign, Channels, FloatArray, Hits, PostureFRF, check_campaign, forward
from twin.measure.motion_log import MotionLog, MotionRun, even_run
from twin.measure.spectra import posture_from_hits
from twin.measure.units import factor, frf_factor, known, measure, same
from twin.ranges import check_array

RECORD_DECAY = 5.0  # rate of the exponential window times the record: e⁻⁵ is left at its end, and hardly any leakage
UNLIKE_CLOCK = 0.01  # share by which a stated rate may differ from the clock's, of rounded stamps
RATE_PER_LINE = 2.56  # samples per second over the highest line an analyser shows: room for its anti-alias filter
MEASURES = {  # of a motion log: on a revolute, on a linear axis
    "position": ("angle", "length"),
    "torque": ("torque", "force"),
    "velocity": ("angular velocity", "velocity"),
    "acceleration": ("angular acceleration", "acceleration"),
    "link_position": ("angle", "length"),
}

RECORDS = {("force",): "N", ("acceleration",): "m/s²"}  # of a hammer test, by what they measure


@dataclass(frozen=True)
class Source:
    """A table and the file it is from."""

    path: Path
    table: Table

    def matches(self, patterns: str | Sequence[str]) -> bool:
        """Whether the file's or the table's name fits one of the patterns."""
        several = [patterns] if isinstance(patterns, str) else patterns
        return any(fnmatchcase(name, p) for p in several for name in (self.path.name, self.table.name))

    def series(self, field: str, taken: Taken, *measures: str) -> FloatArray:
        """Channels (nt, n) in SI.

        Raises:
            InputError: a channel or unit is missing, or the file states another unit.
        """
        names = chosen(list(self.table.channels), taken.channels)
        for name in names:
            if name not in self.table.channels:
                raise InputError(self.path, f"{field}: {name}", f"no such channel; there are {self._some()}")
        if not names:
            raise InputError(self.path, f"{field}: {taken.channels}", f"fits no channel; there are {self._some()}")
        factors, offsets = self._scales(field, taken, len(names))
        axes = len(factors) if factors.ndim == 2 else len(names)
        units = [taken.unit] * axes if isinstance(taken.unit, str) else taken.unit
        if len(units) != axes:
            raise InputError(self.path, f"{field}: unit", f"expected one, or {axes}, found {len(units)}")
        for name, unit in zip(names, units if axes == len(names) else units[:1] * len(names), strict=True):
            self._agree(field, name, unit, taken)
        try:
            scale = np.array([factor(unit, *measures) for unit in units])
        except ValueError as error:
            raise InputError(self.path, f"{field}: unit", str(error)) from error
        values = [np.asarray(self.table.channels[name].values) for name in names]
        lengths = sorted({value.shape for value in values})
        if len(lengths) > 1 or len(lengths[0]) != 1 or values[0].dtype.kind not in "iuf":
            raise InputError(self.path, field, f"expected real channels of one length, found shapes {lengths}")
        found: FloatArray = np.stack(values, axis=1).astype(float)
        found = ((found @ factors.T if factors.ndim == 2 else found * factors) + offsets) * scale
        if measures in RECORDS:
            check_array(self.path, f"{field}: {', '.join(names)}", found, RECORDS[measures])
        return found

    def _agree(self, field: str, name: str, unit: str, taken: Taken) -> None:
        """Refuse a unit of the map that is not the one that the file states of a channel."""
        stated = self.table.channels[name].unit
        converted = "factor" in taken.model_fields_set and not known(stated)  # currents, volts, counts
        if not stated or same(stated, unit) or converted:
            return
        expected = f"the file states {stated!r}, the map {unit!r}: correct the map"
        if not known(stated):
            expected += f", or give a factor, {unit} per {stated}"
        elif isinstance(taken.unit, str) and known(unit) and measure(stated)[0] != measure(unit)[0]:
            expected += ". A list of units, one per axis, serves hinges and slides"
        raise InputError(self.path, f"{field}: {name}: unit", expected)

    def _scales(self, field: str, taken: Taken, count: int) -> tuple[FloatArray, FloatArray]:
        """``factor`` (n,), (1,) or as a matrix (axes, n), and ``offset``, one number or one per axis."""
        rows = taken.factor if isinstance(taken.factor, list) else [taken.factor]
        if len({len(row) for row in rows if isinstance(row, list)}) > 1:
            raise InputError(self.path, f"{field}: factor", "expected rows of the same length")
        factors, offsets = (np.atleast_1d(np.asarray(given, dtype=float)) for given in (rows, taken.offset))
        if factors.ndim == 2 and factors.shape[1] != count:
            expected = f"expected rows of {count} numbers, one per channel, found {factors.shape[1]}"
            raise InputError(self.path, f"{field}: factor", expected)
        axes = len(factors) if factors.ndim == 2 else count
        for key, given, wanted in (("factor", factors, axes), ("offset", offsets, axes)):
            if len(given) not in (1, wanted):
                raise InputError(self.path, f"{field}: {key}", f"expected one, or {wanted}, found {len(given)}")
        return factors, offsets

    def _some(self) -> str:
        names = list(self.table.channels)
        return ", ".join(names[:12]) + (f" and {len(names) - 12} more" if len(names) > 12 else "")


def build_log(sources: Sequence[Source], map_: LogMap) -> MotionLog:
    """A motion log: every table a run, or the tables that ``runs`` puts together; on an even clock.

    Raises:
        InputError: what is missing, or a clock that cannot be repaired.
    """
    sources = sources if map_.runs is None else [_together(sources, *run) for run in map_.runs.items()]
    runs: dict[str, MotionRun] = {}
    notes: list[str] = []
    for source in sources:
        name = source.table.name
        if name in runs:
            raise InputError(source.path, "", f"a second run {name}: rename one of the files")
        series = {
            field: source.series(field, taken, *measures)
            for field, measures in MEASURES.items()
            if (taken := getattr(map_, field)) is not None
        }
        axes = {field: values.shape[1] for field, values in series.items()}
        if len(set(axes.values())) > 1:
            found = ", ".join(f"{field} {count}" for field, count in axes.items())
            raise InputError(source.path, "channels", f"expected as many of each quantity, found {found}")
        time, series, said = _on_one_clock(source, _clock(source, map_, len(series["position"])), series)
        notes += [f"{name}: {said}"] if said else []
        steps = np.diff(time)
        if not (steps > 0).any():
            raise InputError(source.path, "time", "expected increasing instants")
        rate = float(f"{1 / np.median(steps[steps > 0]):.12g}")
        runs[name], repairs = even_run(source.path, name, name, time, series, rate)
        notes += repairs
    if len(runs) > 1 and map_.time is None:
        notes.append(
            "without a channel `time` the clock of every run begins at 0: what changes from run to run, as "
            "friction that warms up, cannot be seen"
        )
    return MotionLog(runs, map_.robot, str(sources[0].path), tuple(notes))


def _together(sources: Sequence[Source], name: str, patterns: str | list[str]) -> Source:
    """One table of all that fit the patterns of a run."""
    here = [source for source in sources if source.matches(patterns)]
    if not here:
        raise InputError(sources[0].path, f"runs.{name}", f"no file or table fits {patterns!r}")
    try:
        return Source(here[0].path, joined(name, [source.table for source in here]))
    except ValueError as error:
        raise InputError(here[0].path, f"runs.{name}", str(error)) from error


def _clock(source: Source, map_: LogMap, count: int) -> FloatArray:
    """(count, n) s: one clock, or one per axis."""
    if map_.time is not None:
        time = source.series("time", map_.time, "time")
        if len(time) != count:
            raise InputError(source.path, "time", f"expected {count} instants, as of the positions, found {len(time)}")
        return time
    if (map_.sample_rate_hz or source.table.sample_rate_hz) is None:
        raise InputError(
            source.path, "time", "expected a channel `time`, or `sample_rate_hz`; the file states no clock"
        )
    return (np.arange(count) / _rate(source, map_))[:, None]


def _on_one_clock(
    source: Source, time: FloatArray, series: dict[str, FloatArray]
) -> tuple[FloatArray, dict[str, FloatArray], str]:
    """Bring axes that have clocks of their own, (nt, n) s, to the instants of the first.

    Returns:
        instants (m,) that all clocks cover, the series (m, n) there, and a note.

    Raises:
        InputError: neither one clock nor one per axis, or a clock that does not increase.
    """
    axes = series["position"].shape[1]
    if time.shape[1] not in (1, axes):
        expected = f"expected one clock, or one for each of the {axes} axes, found {time.shape[1]}"
        raise InputError(source.path, "time: channels", expected)
    if time.shape[1] == 1 or (time == time[:, :1]).all():
        return time[:, 0], series, ""
    if not (np.diff(time, axis=0) > 0).all():
        raise InputError(source.path, "time: channels", "expected increasing instants of every axis")
    first = time[:, 0]
    inside = (first >= time[0].max()) & (first <= time[-1].min())
    if inside.sum() < 2:
        raise InputError(source.path, "time: channels", "expected clocks that overlap")
    at = first[inside]
    moved = {
        field: np.stack([CubicSpline(clock, one)(at) for clock, one in zip(time.T, values.T, strict=True)], axis=1)
        for field, values in series.items()
    }
    apart = float(np.abs(time - time[:, :1]).max())
    return at, moved, f"axes have clocks of their own, up to {apart:.3g} s apart; all are at the instants of the first"


def build_hits(sources: Sequence[Source], map_: HitsMap) -> Campaign:
    """A hammer test from time records, with its FRFs; every hammer point keeps as many blows as the fewest have.

    Raises:
        InputError: a point without blows, tables of different rates, channels or units.
    """
    postures = {name: _struck(sources, map_, name, stance) for name, stance in map_.postures.items()}
    return _campaign(sources[0].path, map_, postures)


def _struck(sources: Sequence[Source], map_: HitsMap, name: str, stance: Stance) -> PostureFRF:
    force, response, rates = [], [], set()
    for point in map_.excitation:
        here = [source for source in sources if source.matches(stance.files) and source.matches(point.files)]
        blows = []
        for source in here:
            rate = _rate(source, map_)
            rates.add(rate)
            blows += _blows(source, map_, rate)
        if not blows:
            fit = [p for p in (stance.files, point.files) if not any(source.matches(p) for source in sources)]
            text = f"no record fits {fit[0] if fit else (stance.files, point.files)!r}"
            if here:
                text = (
                    f"no blow above {map_.trigger_n:g} N (trigger_n) among {len(here)} records that lies whole in one, "
                    f"with {map_.pretrigger_s:g} s before it (pretrigger_s) and {map_.record_s:g} s in all (record_s)"
                )
            raise InputError(sources[0].path, f"postures.{name}: {point.label}", f"{text}; expected one or more")
        force.append([f for f, _ in blows])
        response.append([r for _, r in blows])
    if len(rates) > 1:
        raise InputError(sources[0].path, f"postures.{name}", f"expected one sampling rate, found {sorted(rates)} Hz")
    least = min(map(len, force))
    rate = rates.pop()
    hits = Hits(
        np.array([f[:least] for f in force]), np.array([r[:least] for r in response]), rate,
        round(map_.pretrigger_s * rate) / rate,
    )  # fmt: skip
    low, high = map_.band_hz or (0.0, rate / RATE_PER_LINE)
    window = RECORD_DECAY / map_.record_s if map_.exponential_window_rate is None else map_.exponential_window_rate
    made, _ = posture_from_hits(
        name, np.array(stance.q_deg, dtype=float), stance.brakes, hits, exponential_window_rate=window, fmax=high,
        source=str(sources[0].path),
    )  # fmt: skip
    kept = made.frequency >= low
    if kept.sum() < 2:
        raise InputError(sources[0].path, "band_hz", f"no lines from {low:g} to {high:g} Hz")
    coherence = None if made.coherence is None else made.coherence[kept]
    return replace(made, frequency=made.frequency[kept], frf=made.frf[kept], coherence=coherence)


def _rate(source: Source, map_: HitsMap | LogMap) -> float:
    """Samples per second: as the file's clock has them, or the file states, or the map.

    A clock that starts again with every blow, or skips samples, tells no rate. Stamps may be rounded, to a sample.
    """
    named = {name: source.table.channels[name].unit for name in clocks(source.table)}
    taken = map_.time or next((Taken(channels=[n], unit=unit) for n, unit in named.items() if known(unit)), None)
    stated, rate = map_.sample_rate_hz or source.table.sample_rate_hz, None
    if taken is not None:
        time = source.series("time", taken, "time")[:, 0]
        even = np.linspace(time[0], time[-1], len(time))
        period = (even[-1] - even[0]) / max(len(time) - 1, 1)
        if period > 0 and np.abs(time - even).max() <= period:
            rate = float(f"{1 / period:.4g}")
    if stated and rate and abs(rate / stated - 1) > UNLIKE_CLOCK:
        clock = next(iter(named), "time")
        text = f"found {stated:g} in the map, and {rate:g} by the file's clock {clock!r}; correct one"
        raise InputError(source.path, "sample_rate_hz", text)
    if not (found := stated or rate):
        text = "the file has no even clock" if named else "the file states no rate"
        raise InputError(source.path, "sample_rate_hz", f"{text}; expected it in the map")
    return found


def _blows(source: Source, map_: HitsMap, rate: float) -> list[tuple[FloatArray, FloatArray]]:
    """Force (nt,) and response (nr, nt) of each blow that lies whole in the record and is not run into by the next."""
    force = source.series("force", map_.force, "force")
    if force.shape[1] != 1:
        raise InputError(source.path, "force", f"expected one channel, found {force.shape[1]}")
    sensors = [
        source.series(f"response {s.label}", Taken(channels=[s.channel], unit=s.unit, factor=s.factor), "acceleration")
        for s in map_.response
    ]
    signal = force[:, 0] - np.median(force)
    before, length = round(map_.pretrigger_s * rate), round(map_.record_s * rate)
    if length < before + 2:
        expected = f"expected more than pretrigger_s and two samples at {rate:g} Hz, found {map_.record_s:g} s"
        raise InputError("map", "record_s", expected)
    if length > len(signal):
        text = f"found {map_.record_s:g} s; expected at most the {len(signal) / rate:.4g} s of {source.path.name}"
        raise InputError("map", "record_s", text)
    above = np.abs(signal) > map_.trigger_n
    starts: list[int] = []
    for start in np.flatnonzero(above & ~np.concatenate([[False], above[:-1]])):
        if not starts or start - starts[-1] >= length - before:
            starts.append(int(start))
    cuts = [slice(start - before, start - before + length) for start in starts if start >= before]
    return [(force[cut, 0], np.array([s[cut, 0] for s in sensors])) for cut in cuts if cut.stop <= len(force)]


def build_universal(paths: Sequence[Path], map_: UniversalMap) -> Campaign:
    """A hammer test from universal files without any words of ours; nodes by the map, else by data sets 15 or 2411.

    Raises:
        InputError: a posture without files, or postures with different channels.
    """
    from twin.measure.uff import Point as Node
    from twin.measure.uff import read_uff

    nodes = {n: Node(point.body, np.array(point.position, dtype=float)) for n, point in map_.nodes.items()} or None
    read: dict[str, Campaign] = {}
    for name, stance in map_.postures.items():
        patterns = [stance.files] if isinstance(stance.files, str) else stance.files
        here = [path for path in paths if any(fnmatchcase(path.name, p) for p in patterns)]
        if not here:
            raise InputError(paths[0], f"postures.{name}: files", f"no file fits {stance.files!r}")
        try:
            frf_factor(map_.unit)
        except ValueError as error:
            raise InputError(paths[0], "unit", str(error)) from error
        read[name] = read_uff(
            here, q_deg=np.array(stance.q_deg, dtype=float), points=nodes, unit=map_.unit,
            placed=map_.robot is not None or nodes is not None,
        )  # fmt: skip
    first = next(iter(read.values()))
    postures = {}
    for name, campaign in read.items():
        if campaign.response.label != first.response.label or campaign.excitation.label != first.excitation.label:
            raise InputError(campaign.source, f"postures.{name}", "expected the channels of the first posture")
        if len(campaign.postures) > 1:
            raise InputError(campaign.source, f"postures.{name}", "its files name several postures themselves")
        (only,) = campaign.postures.values()
        postures[name] = map_.said_of(name, only)
        if only.coherence is not None and postures[name].averages is None:
            told = "are not stated, so the coherence tells no noise; give them as averages in the map"
            tell(campaign.source, f"postures.{name}: averages", told)
    return forward(first.source, replace(first, postures=postures, robot=map_.robot))


def build_functions(sources: Sequence[Source], map_: FunctionsMap) -> Campaign:
    """A hammer test from arrays of FRFs.

    Raises:
        InputError: a posture without a table, arrays of another shape, units that are no FRF's.
    """
    postures = {}
    for name, stance in map_.postures.items():
        here = [source for source in sources if source.matches(stance.files)]
        if len(here) != 1:
            raise InputError(sources[0].path, f"postures.{name}: files", f"expected one table, {len(here)} fit")
        postures[name] = _functions(here[0], map_, name, stance)
    return _campaign(sources[0].path, map_, postures)


def _functions(source: Source, map_: FunctionsMap, name: str, stance: Stance) -> PostureFRF:
    try:
        quantity, scale = frf_factor(map_.frf.first_unit)
    except ValueError as error:
        raise InputError(source.path, "frf: unit", str(error)) from error
    frequency = source.series("frequency", map_.frequency, "frequency")[:, 0]
    shape = len(frequency), len(map_.response), len(map_.excitation)

    def array(field: str, wanted: str | Sequence[str]) -> np.ndarray:
        names = chosen(list(source.table.channels), wanted)
        if len(names) != 1 or names[0] not in source.table.channels:
            raise InputError(source.path, field, f"expected one array, {wanted!r} fits {len(names)}")
        values = np.asarray(source.table.channels[names[0]].values)
        if (order := _axes(values.shape, shape)) is None:
            expected = f"expected {shape} numbers (frequency, response, excitation), found {values.shape}"
            raise InputError(source.path, field, expected)
        if order != tuple(sorted(order)):
            said = ", ".join(("frequency", "response", "excitation")[order.index(k)] for k in range(3))
            tell(str(source.path), field, f"its axes are taken as {said}")
        return values.reshape([shape[order.index(k)] for k in range(3)]).transpose(order)

    made = PostureFRF(
        name, np.array(stance.q_deg, dtype=float), stance.brakes, frequency,
        array("frf", map_.frf.channels).astype(complex) * scale * np.asarray(map_.frf.factor), quantity,  # type: ignore[arg-type]
        coherence=None if map_.coherence is None else array("coherence", map_.coherence).astype(float),
    )  # fmt: skip
    return map_.said_of(name, made)


def _axes(found: tuple[int, ...], wanted: tuple[int, int, int]) -> tuple[int, ...] | None:
    """Which axis of an array is frequency, response and excitation; None where its lengths do not tell.

    The order of the contract goes first; then the lines of frequency are moved, so that responses stay before
    excitations where both are as many. Axes of length one may be left out.
    """
    kept = [n for n in found if n != 1]
    for order in ((0, 1, 2), (1, 0, 2), (2, 0, 1), (0, 2, 1), (1, 2, 0), (2, 1, 0)):
        lengths = [wanted[order.index(k)] for k in range(3)]
        if [n for n in lengths if n != 1] == kept:
            return order
    return None


def _campaign(path: Path, map_: HitsMap | FunctionsMap, postures: dict[str, PostureFRF]) -> Campaign:
    found = Campaign(_channels(map_.response), _channels(map_.excitation), postures, robot=map_.robot, source=str(path))
    check_campaign(path, found)
    return forward(path, found)


def _channels(points: Sequence[Struck] | Sequence[Sensor]) -> Channels:
    axis = [np.eye(3)["XYZ".index(p.label[-2])] * (1 if p.label[-1] == "+" else -1) for p in points]
    return Channels(
        tuple(p.label for p in points), tuple(p.body for p in points),
        np.array([p.position for p in points], dtype=float), np.array(axis),
    )  # fmt: skip
