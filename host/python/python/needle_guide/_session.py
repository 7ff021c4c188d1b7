"""Sessions, and what is computed from them."""

from __future__ import annotations

import datetime
import json
import os
import pathlib
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal, TypeVar

from . import _arrays, _core
from ._errors import NeedleGuideError, UsageError
from ._folders import Folder
from ._results import Check, Diagnosis, Identification, Prediction, Summary, Tracking
from ._values import Result

PathLike = str | os.PathLike[str]
OnStep = Callable[[str], object]
_R = TypeVar("_R", bound=Result)


def call(arguments: Sequence[str], on_step: OnStep | None = None) -> tuple[Any, list[str], dict[str, str]]:
    """Runs a command of ``guide`` and returns its JSON document, its notes and its figures.

    Args:
        arguments: those of the command line, without ``--json``.
        on_step: called with the name of every step of a long computation.

    Raises:
        NeedleGuideError: as the command fails.

    >>> document, notes, figures = call(["effects", "tissue.layers"])
    >>> document["schema"]
    'guide.effects/1'
    """
    text, notes, figures = _core.call([str(argument) for argument in arguments], on_step)
    return json.loads(text) if text.strip() else None, notes, dict(figures)


def _result(kind: type[_R], arguments: Sequence[str], on_step: OnStep | None = None) -> _R:
    return kind(*call(arguments, on_step))


def options(**options: object) -> list[str]:
    """Options of a command line: ``true`` ones without a value, none where the value is None or False."""
    arguments: list[str] = []
    for name, value in options.items():
        flag = "--" + name.replace("_", "-")
        if value is None or value is False:
            continue
        if value is True:
            arguments.append(flag)
        elif isinstance(value, (list, tuple)):
            for one in value:
                arguments.append(f"{flag}={_text(name, one)}")
        else:
            arguments.append(f"{flag}={_text(name, value)}")
    return arguments


def _text(name: str, value: object) -> str:
    if isinstance(value, bool) or not isinstance(value, (str, int, float, os.PathLike)):
        raise UsageError(f"{name}: {type(value).__name__}, expected a number, a text or a path")
    if isinstance(value, float):
        return repr(float(value))
    return os.fspath(value) if isinstance(value, os.PathLike) else str(value)


class Session:
    """What one needle and one rig have measured in one piece of tissue.

    Every method runs the command of the same name on the session's folder: same options, same numbers, same figures.
    Ctrl-C ends a call. All methods may be called from several threads.

    >>> session = Session.example()
    >>> session.check().usable
    True
    >>> found = session.identify()
    >>> print(found.k_kpa)
    17.88 kPa (15.39 to 20.78)
    """

    def __init__(self, path: PathLike, *, keep: object = None, name: str | None = None) -> None:
        self.path = pathlib.Path(path)
        self._keep = keep
        self._name = name

    @classmethod
    def open(cls, path: PathLike) -> Session:
        """The session in a folder that holds ``session.toml``.

        Raises:
            FileError: it cannot be read; has file, line, column and field.
        """
        _core.readable(os.fspath(path))
        return cls(path)

    @classmethod
    def example(cls, seed: int = 1) -> Session:
        """The simulated example of ``guide init --example``, in a folder that is removed with the object.

        Args:
            seed: seed of its noise.
        """
        folder = Folder()
        path = folder.path / "example"
        call(["init", str(path), "--example", f"--seed={seed}"])
        return cls(path, keep=folder)

    @classmethod
    def from_arrays(
        cls,
        *,
        needle: Mapping[str, object],
        rig: Mapping[str, object],
        lateral: Sequence[Mapping[str, Any]] = (),
        insertion: Sequence[Mapping[str, Any]] = (),
        steering: Sequence[Mapping[str, Any]] = (),
        noise: Mapping[str, object] | None = None,
        tissue: Mapping[str, object] | None = None,
        subject: Mapping[str, object] | None = None,
        covariates: Mapping[str, object] | None = None,
        name: str | None = None,
        date: datetime.date | str | None = None,
        site: str | None = None,
    ) -> Session:
        """A session from arrays. All names are those of session files (see the manual), with their units.

        Args:
            needle: ``youngs_modulus_gpa``, ``outer_diameter_mm``, ``inner_diameter_mm``, ...
            rig: ``guide2_mm``, ``entry_mm``, ...
            lateral: runs ``{"id", "depth_mm", "force", "shape"}``; ``force`` maps ``time_s``, ``displacement_y_mm`` and
                ``force_y_n`` to arrays, ``shape`` maps ``z_mm`` and ``deflection_y_mm``. A DataFrame does as well.
            insertion: runs ``{"id", "path"}``; ``path`` maps ``depth_mm`` and ``tip_y_mm`` to arrays.
            steering: runs ``{"id", "data"}``; ``data`` maps ``time_s``, ``depth_mm``, ``base_y_mm``, ``base_force_y_n`` and
                ``tip_y_mm``.
            noise: standard deviations of single readings, such as ``force_n``.
            tissue: what is stated of the tissue.
            subject: ``id`` of phantom, animal or patient.
            covariates: numbers and texts for statistics over many sessions.
            name: name of the session, and of its record among those of others.
            date: day of the measurement, such as "2026-03-01".
            site: where it was measured.

        Masked values of arrays are missing ones.

        Raises:
            UsageError: names the array or field that is wrong, and what is expected (``ArgumentError`` where session files do not
                allow a value).
        """
        folder = Folder()
        path = folder.path / "session"
        path.mkdir()
        labels = {"date": None if date is None else str(date), "site": site}
        session_table = {"format": 1, "name": name or "from arrays", **{key: value for key, value in labels.items() if value is not None}}
        tables: dict[str, Mapping[str, object]] = {"session": session_table, "needle": needle, "rig": rig}
        stated = {"noise": noise, "tissue": tissue, "subject": subject, "covariates": covariates}
        tables.update({key: value for key, value in stated.items() if value is not None})
        _arrays.write(path, tables, {"lateral": lateral, "insertion": insertion, "steering": steering})
        try:
            _core.readable(str(path))
        except NeedleGuideError as error:
            raise _arrays.of_arguments(error, path) from None
        session = cls(path, keep=folder, name=name)
        # A field that is not part of the format is ignored in a file and reported by a check; here nobody would see that.
        for one in session.check().findings:
            if "not part of the format" in one.what:
                raise UsageError(one.what + (f", expected {one.expected}" if one.expected else ""))
        return session

    def _folder(self) -> list[str]:
        # A folder whose name begins with a dash is no option.
        text = str(self.path)
        return [f"./{text}" if text.startswith("-") else text]

    def check(self) -> Check:
        """Errors, warnings, and what each command can do with the session (``guide check``). Errors are findings."""
        try:
            return _result(Check, ["check", *self._folder()])
        except NeedleGuideError as error:
            if not error.document:
                raise
            return Check(json.loads(error.document))

    def identify(
        self,
        *,
        relation: str | None = None,
        poisson: float | None = None,
        poisson_sd: float | None = None,
        foundation: Literal["auto", "springs", "body"] | None = None,
        nuisance: Sequence[str] = (),
        model: PathLike | None = None,
        prior: PathLike | None = None,
        layers: bool = False,
        profile: bool = False,
        bootstrap: int | None = None,
        seed: int = 1,
    ) -> Identification:
        """Modulus of the tissue from the lateral runs (``guide identify``).

        Args:
            relation: from the foundation modulus K to Young's modulus E, such as "continuum".
            poisson: Poisson's ratio of the tissue.
            poisson_sd: its standard deviation.
            foundation: "auto", "springs" or "body".
            nuisance: effects whose parameters are unknown, such as "rig.backlash".
            model: file of ``guide diagnose --out``.
            prior: file of ``guide population --out``.
            layers: find two layers.
            profile: the interval of the profile likelihood too.
            bootstrap: draws of a parametric bootstrap.
            seed: its seed.

        Raises:
            FileError: the session cannot be read.
            AnalysisError: the data do not allow it.
            UsageError: an argument is out of range.
        """
        chosen = options(
            relation=relation,
            poisson=poisson,
            poisson_sd=poisson_sd,
            foundation=foundation,
            nuisance=list(nuisance),
            model=model,
            prior=prior,
            layers=layers,
            profile=profile,
            bootstrap=bootstrap,
            seed=seed,
        )
        return _result(Identification, ["identify", *self._folder(), *chosen])

    def predict(
        self,
        until_mm: float = 50.0,
        *,
        to_mm: float | None = None,
        k_kpa: tuple[float, float] | None = None,
        layers: bool = False,
        effect: Mapping[str, float | Sequence[float]] | None = None,
        model: PathLike | None = None,
        prior: PathLike | None = None,
        alone: bool = False,
    ) -> Prediction:
        """Tip load from the first part of every insertion, path with its band for the rest (``guide predict``).

        Args:
            until_mm: depth up to which readings are used, millimetres.
            to_mm: depth to which it is predicted, millimetres (default: the last recorded depth).
            k_kpa: foundation modulus and its standard deviation, kilopascals, instead of the estimate.
            layers: take two layers from the lateral runs.
            effect: effects with the values of their parameters.
            model: file of ``guide diagnose --out``.
            prior: file of ``guide population --out``.
            alone: without learning from the other insertions.

        >>> Session.example().predict(until_mm=50).insertions[0].tip_y_ci95_mm.shape
        (101, 2)
        """
        values = {} if effect is None else dict(effect)
        texts = [f"{name}={','.join(repr(float(one)) for one in _many(value))}" for name, value in values.items()]
        modulus = [] if k_kpa is None else ["--k-kpa", *(repr(float(one)) for one in k_kpa)]
        chosen = options(
            until=float(until_mm),
            to=None if to_mm is None else float(to_mm),
            layers=layers,
            effect=texts,
            model=model,
            prior=prior,
            alone=alone,
        )
        return _result(Prediction, ["predict", *self._folder(), *chosen, *modulus])

    def track(
        self, *, length_mm: float | None = None, fixture_kg: float | None = None, compare: bool = False
    ) -> Tracking:
        """Stiffness and damping of the tissue online, over the steering runs (``guide track``).

        Args:
            length_mm: length of the needle from the fixture to the tip, millimetres (default: the session's).
            fixture_kg: mass of the fixture, kilograms (default: the session's).
            compare: run the published estimator and Kalman filters too.
        """
        chosen = options(length_mm=length_mm, fixture_kg=fixture_kg, compare=compare)
        return _result(Tracking, ["track", *self._folder(), *chosen])

    def diagnose(
        self,
        reference: PathLike | Session | None = None,
        *,
        model: PathLike | None = None,
        out: PathLike | None = None,
        foundation: Literal["auto", "springs", "body"] | None = None,
        poisson: float | None = None,
        seed: int = 1,
        on_step: OnStep | None = None,
    ) -> Diagnosis:
        """Where model and measurement disagree, and the effect that is missing (``guide diagnose``).

        Args:
            reference: session with the same rig and tissue; only differences from it are searched.
            model: file of an earlier diagnosis, whose effects are in the model from the beginning.
            out: file for the model with the effects that were added.
            foundation: "auto", "springs" or "body".
            poisson: Poisson's ratio of the tissue where it is a body.
            seed: seed of the bootstraps.
            on_step: called with the name of every step.
        """
        folder = reference.path if isinstance(reference, Session) else reference
        chosen = options(reference=folder, model=model, out=out, foundation=foundation, poisson=poisson, seed=seed)
        return _result(Diagnosis, ["diagnose", *self._folder(), *chosen], on_step)

    def summarize(self, *, seed: int = 1) -> Summary:
        """The record of the session for :func:`population` (``guide summarize``). A session that fails gives a record with its error.

        Args:
            seed: seed of the bootstraps of its diagnosis.
        """
        line = _core.summarize(str(self.path), seed)
        if self._name is None:
            return Summary(line)
        # Its folder is a temporary one, which says nothing in a table of many sessions.
        return Summary(json.dumps({**json.loads(line), "session": self._name}))

    def __repr__(self) -> str:
        return f"Session({str(self.path)!r})"


def _many(value: float | Sequence[float]) -> Sequence[float]:
    return (value,) if isinstance(value, (int, float)) else value


def summarize(path: PathLike, seed: int = 1) -> Summary:
    """The record of the session in a folder: :meth:`Session.summarize` as a function, for ``map`` of Dask and others."""
    return Summary(_core.summarize(os.fspath(path), seed))
