"""Typed results over many sessions."""

from __future__ import annotations

import datetime
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from . import _plots
from ._errors import UsageError
from ._units import parameter
from ._values import Document, Quantity, Records, Result, columns, interval

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True)
class Level:
    """The spread of one level of a group of sessions.

    Attributes:
        name: its label, such as "subject"; the last level is "session".
        groups: its groups; of the last level sessions.
        tau: standard deviation of ln K; none where the level cannot be told from the one within it.
        degrees_of_freedom: those of the spread.
        icc: intraclass correlation of two sessions of a group of this level, as measured.
    """

    name: str
    groups: int
    tau: Quantity | None
    degrees_of_freedom: int
    icc: Quantity | None


@dataclass(frozen=True)
class Group:
    """K of one group of sessions.

    Attributes:
        name: values of its labels.
        sessions: sessions that count.
        subjects: subjects among them.
        k_kpa: geometric mean, kilopascals.
        degrees_of_freedom: those of the mean.
        tau: standard deviation of ln K between sessions, all levels together: 0.1 is about 10 % of K.
        levels: every level from the outermost, last the sessions.
        new_subject95_kpa: interval of a new subject's K; none with too few of them.
        new_session95_kpa: interval of K in a session of a new subject.
        common_sd: standard deviation of ln K that stated errors have in common, where sessions scatter less than these.
        slopes: of ln K, by covariate.
    """

    name: str
    sessions: int
    subjects: int
    k_kpa: Quantity
    degrees_of_freedom: float
    tau: Quantity
    levels: tuple[Level, ...]
    new_subject95_kpa: tuple[float, float] | None
    new_session95_kpa: tuple[float, float] | None
    common_sd: float | None
    slopes: dict[str, Quantity]


@dataclass(frozen=True)
class SharedEffect:
    """An effect that the sessions of a group share.

    Attributes:
        effect: name in the catalogue.
        label: "rig", "needle", "tissue", "day" or "all".
        group: value of the label.
        kind: "shared" (the same in all), "step" (from a date on) or "trend".
        sessions: sessions that have it.
        parameters: values with their intervals, by name.
        log_evidence: over the model without it, nats.
        p_adjusted: probability by chance times the number of tests.
        began: first date with it.
        began_ci95: the dates between which it began with 95 % probability.
        competing: effects and groups that explain it about as well, such as "rig r1: sensor.force_gain".
    """

    effect: str
    label: str
    group: str
    kind: Literal["shared", "step", "trend"]
    sessions: int
    parameters: dict[str, Quantity]
    log_evidence: float
    p_adjusted: float
    began: datetime.date | None
    began_ci95: tuple[datetime.date, datetime.date] | None
    competing: tuple[str, ...]


@dataclass(frozen=True)
class EffectSpread:
    """How an effect is spread over all sessions, beside what groups share.

    Attributes:
        effect: name in the catalogue.
        kind: "shared" (the same in all), "varying" or "single" (in single sessions).
        sessions: sessions in which it is identifiable.
        named_by_sessions: sessions that name it by themselves.
        log_evidence: of its kind over no effect, nats.
        heterogeneity_p: probability that estimates of the same value differ as much.
    """

    effect: str
    kind: Literal["shared", "varying", "single"]
    sessions: int
    named_by_sessions: int
    log_evidence: float
    heterogeneity_p: float


@dataclass(frozen=True)
class Agreement:
    """Two rigs, needles or sites on the same subjects.

    Attributes:
        label: "rig", "needle" or "site".
        between: the two values.
        subjects: subjects that were measured with both.
        ratio: geometric mean of K of the first over that of the second.
        limits95: ratios between which 95 % of single subjects lie.
    """

    label: str
    between: tuple[str, str]
    subjects: int
    ratio: Quantity
    limits95: tuple[float, float]


@dataclass(frozen=True)
class TipLoad:
    """Tip load by needle and tissue.

    Attributes:
        needle: the needle, where it is stated.
        tissue: the tissue, where it is stated.
        sessions: sessions with insertions.
        load_n: mean, newtons.
        between_n: standard deviation between sessions, newtons.
    """

    needle: str | None
    tissue: str | None
    sessions: int
    load_n: Quantity
    between_n: float | None


@dataclass(frozen=True)
class SessionRow:
    """One session in the population.

    Attributes:
        session: its folder.
        group: its group.
        rig: its rig.
        date: its date.
        k_kpa: K, shared effects corrected, kilopascals.
        k_recorded_kpa: K as it is in the record.
        k_shrunk_kpa: its true K from itself and what the others predict; none where it does not count.
        residual: distance from what all others predict, in standard deviations.
        p_adjusted: probability of a larger distance in at least one of the sessions.
        weight: 1; less where it is far from the others, 0 where it is not used.
        used: whether it counts.
    """

    session: str
    group: str
    rig: str | None
    date: datetime.date | None
    k_kpa: Quantity
    k_recorded_kpa: float
    k_shrunk_kpa: Quantity | None
    residual: float | None
    p_adjusted: float | None
    weight: float
    used: bool


@dataclass(frozen=True)
class ListedSession:
    """A session that does not count, or counts less.

    Attributes:
        session: its folder.
        reason: why.
        weight: its weight beside one that is not listed.
    """

    session: str
    reason: str
    weight: float


def _kpa(value: Document) -> Quantity:
    return Quantity(value["value"], "kPa", interval(value["ci95"]))


def _date(value: str | None) -> datetime.date | None:
    return None if value is None else datetime.date.fromisoformat(value)


def _level(one: Document) -> Level:
    tau, icc = one["tau"], one["icc"]
    return Level(
        str(one["level"]),
        int(one["groups"]),
        None if tau is None else Quantity(tau, "", interval(one["tau_ci95"])),
        int(one["degrees_of_freedom"]),
        None if icc is None else Quantity(icc, "", interval(one["icc_ci95"])),
    )


def _group(one: Document) -> Group:
    return Group(
        str(one["group"]),
        int(one["sessions"]),
        int(one["subjects"]),
        _kpa(one["k_kpa"]),
        float(one["degrees_of_freedom"]),
        Quantity(one["tau"], "", interval(one["tau_ci95"])),
        tuple(_level(level) for level in one["levels"]),
        interval(one["new_subject95_kpa"]),
        interval(one["new_session95_kpa"]),
        one["common_sd"],
        {name: Quantity(value["value"], "", interval(value["ci95"])) for name, value in one["slopes"].items()},
    )


def _place(one: Document) -> str:
    return str(one["group"]) if one["label"] == "all" else f"{one['label']} {one['group']}"


def _shared(one: Document) -> SharedEffect:
    began = one["began_ci95"]
    return SharedEffect(
        str(one["effect"]),
        str(one["label"]),
        str(one["group"]),
        one["kind"],
        int(one["sessions"]),
        {of["name"]: parameter(one["effect"], of["name"], of) for of in one["parameters"]},
        float(one["log_evidence"]),
        float(one["p_adjusted"]),
        _date(one["began"]),
        None if began is None else (datetime.date.fromisoformat(began[0]), datetime.date.fromisoformat(began[1])),
        tuple(f"{_place(other)}: {other['effect']}" for other in one["class"]),
    )


def _row(one: Document) -> SessionRow:
    shrunk = one["k_shrunk_kpa"]
    return SessionRow(
        str(one["session"]),
        str(one["group"]),
        one["rig"],
        _date(one["date"]),
        _kpa(one["k_kpa"]),
        float(one["k_recorded_kpa"]),
        None if shrunk is None else _kpa(shrunk),
        one["residual"],
        one["p_adjusted"],
        float(one["weight"]),
        bool(one["used"]),
    )


class Population(Result):
    """Statistics over many sessions.

    Attributes:
        prior_toml: text of ``prior.toml``: what may be assumed of the next session.
        draws: of every group: draws of ``ln_k_kpa`` and of the spread of every level, ``tau_subject``, ``tau_session``, ...
    """

    prior_toml: str = ""
    draws: Mapping[str, Mapping[str, Sequence[float]]] = {}

    @property
    def groups(self) -> tuple[Group, ...]:
        """K of every group."""
        return tuple(_group(one) for one in self._document["groups"])

    @property
    def rows(self) -> tuple[SessionRow, ...]:
        """Every session that has a modulus."""
        return tuple(_row(one) for one in self._document["rows"])

    @property
    def shared_effects(self) -> tuple[SharedEffect, ...]:
        """Effects that groups of sessions share, and drift."""
        return tuple(_shared(one) for one in self._document["shared_effects"])

    @property
    def spread(self) -> tuple[EffectSpread, ...]:
        """How other effects are spread over the sessions; those that are absent are not listed."""
        return tuple(
            EffectSpread(
                str(one["effect"]),
                one["kind"],
                int(one["sessions"]),
                int(one["named_by_sessions"]),
                float(one[f"log_evidence_{one['kind']}"]),
                float(one["heterogeneity_p"]),
            )
            for one in self._document["spread"]
        )

    @property
    def agreement(self) -> tuple[Agreement, ...]:
        """Rigs, needles and sites that measured the same subjects."""
        return tuple(
            Agreement(
                str(one["label"]),
                (str(one["between"][0]), str(one["between"][1])),
                int(one["subjects"]),
                Quantity(one["ratio"], "", interval(one["ratio_ci95"])),
                (float(one["limits95"][0]), float(one["limits95"][1])),
            )
            for one in self._document["agreement"]
        )

    @property
    def tip_load(self) -> tuple[TipLoad, ...]:
        """Tip load by needle and tissue."""
        return tuple(
            TipLoad(
                one["needle"],
                one["tissue"],
                int(one["sessions"]),
                Quantity(one["load_n"]["value"], "N", interval(one["load_n"]["ci95"])),
                one["between_n"],
            )
            for one in self._document["tip_load"]
        )

    @property
    def listed_sessions(self) -> tuple[ListedSession, ...]:
        """Sessions that do not count, failed or unexplained, and those that count less, far from the others."""
        return tuple(
            ListedSession(str(one["session"]), str(one["reason"]), float(one["weight"]))
            for one in self._document["listed"]
        )

    @property
    def listed(self) -> tuple[str, ...]:
        """Their names."""
        return tuple(one.session for one in self.listed_sessions)

    def to_arviz(self, group: str | None = None) -> Any:
        """Draws of mean and spreads of a group as an ``arviz.InferenceData``: ``ln_k_kpa``, ``tau_subject``, ``tau_session``, ...

        They are independent draws, of one chain; spreads of 0 are of draws in which the sessions differ by less than their errors.

        Args:
            group: name of the group; may be left out where there is one.

        Raises:
            UsageError: there is no such group, or there are several.
            ImportError: arviz is not installed.
        """
        try:
            import arviz
        except ImportError as error:
            raise ImportError("draws need arviz: pip install 'needle-guide[frames]'") from error
        names = ", ".join(self.draws) or "none"
        if group is None and len(self.draws) != 1:
            raise UsageError(f"group: missing, expected one of {names}")
        if group is not None and group not in self.draws:
            raise UsageError(f'group: "{group}" is not there, expected one of {names}')
        of = next(iter(self.draws.values())) if group is None else self.draws[group]
        draws: dict[str, Any] = {name: np.asarray(values)[None, :] for name, values in of.items()}
        return arviz.from_dict(posterior=draws)

    def plot_forest(self, ax: Axes | None = None) -> Axes:
        """Draws K of every session and group with matplotlib."""
        return _plots.forest(self, ax)

    def plot_levels(self, ax: Axes | None = None) -> Axes:
        """Draws the spread of every level of every group with matplotlib."""
        return _plots.levels(self, ax)

    def _records(self) -> Records:
        """One row per session that has a modulus."""
        return [
            {
                "session": row.session,
                "group": row.group,
                "rig": row.rig,
                "date": row.date,
                **columns({"k_kpa": row.k_kpa, "k_shrunk_kpa": row.k_shrunk_kpa}),
                "k_recorded_kpa": row.k_recorded_kpa,
                "residual": row.residual,
                "p_adjusted": row.p_adjusted,
                "weight": row.weight,
                "used": row.used,
            }
            for row in self.rows
        ]

    def _rows(self) -> list[tuple[str, str]]:
        rows = [(f"K of {one.name}", f"{one.k_kpa}, {one.sessions} sessions") for one in self.groups]
        rows += [(f"shared by {one.label} {one.group}", one.effect) for one in self.shared_effects]
        return rows + [(f"weight {one.weight:.2f}", f"{one.session}: {one.reason}") for one in self.listed_sessions]
