"""Statistics over many sessions."""

from __future__ import annotations

import os
import pathlib
import re
import tempfile
from collections.abc import Callable, Iterable, Sequence

from ._errors import ArgumentError, NeedleGuideError, UsageError
from ._population import Population
from ._results import Summary
from ._session import PathLike, call, options

_OPTIONS = {"by": "by", "nested": "nested", "covariate": "covariate"}


def summarize_all(
    paths: Iterable[PathLike], *, seed: int = 1, progress: Callable[[int, Summary], object] | None = None
) -> list[Summary]:
    """The records of sessions, one after the other on all cores; one that fails becomes a record with its error.

    Args:
        paths: folders of sessions.
        seed: seed of the bootstraps of every diagnosis.
        progress: called after every session with the number of those that are done, and the last record.
    """
    from ._session import summarize

    found: list[Summary] = []
    for path in paths:
        found.append(summarize(path, seed))
        if progress is not None:
            progress(len(found), found[-1])
    return found


def population(
    summaries: Summary | PathLike | Iterable[Summary | PathLike],
    *,
    by: str | Sequence[str] = (),
    nested: str | Sequence[str] = (),
    independent: bool = False,
    covariate: str | Sequence[str] = (),
) -> Population:
    """What many sessions have in common, and what is unusual (``guide population``).

    Args:
        summaries: records, or files of records that ``guide summarize`` has written; or one of them.
        by: labels or covariates that groups are formed by, such as "tissue".
        nested: levels whose sessions have something in common, outermost first (default: site and subject, as stated).
        independent: take all sessions for independent, also several of one subject; intervals are then too narrow.
        covariate: covariates that ln K depends on linearly.

    Raises:
        UsageError: a label that no session states, or a record that is there twice.
        FileError: a file of records cannot be read.
        AnalysisError: nothing is left to be analysed.
    """
    given = [summaries] if isinstance(summaries, (Summary, str, os.PathLike)) else list(summaries)
    if not given:
        raise UsageError("summaries: none, expected at least one record or file")
    places = [number for number, one in enumerate(given) if isinstance(one, Summary)]
    lines = [one.to_json() for one in given if isinstance(one, Summary)]
    files = [os.fspath(one) for one in given if not isinstance(one, Summary)]
    with tempfile.TemporaryDirectory(prefix="needle-guide-") as folder:
        own = pathlib.Path(folder) / "summaries.jsonl"
        if lines:
            own.write_text("\n".join(lines) + "\n", encoding="utf-8")
            files.insert(0, str(own))
        prior = pathlib.Path(folder) / "prior.toml"
        names = {"by": by, "nested": nested, "covariate": covariate}
        chosen = {key: list((value,) if isinstance(value, str) else value) for key, value in names.items()}
        arguments = options(**chosen, independent=independent, draws=True, out=prior)
        try:
            document, notes, figures = call(["population", *files, *arguments])
        except NeedleGuideError as error:
            raise _of_arguments(error, str(own), places) from None
        # The document is that of the command without them.
        draws = {str(one["group"]): one.pop("draws") for one in document["groups"]}
        found = Population(document, [note for note in notes if str(prior) not in note], figures)
        found.draws = draws
        found.prior_toml = prior.read_text(encoding="utf-8")
        return found


def _of_arguments(error: NeedleGuideError, own: str, places: list[int]) -> NeedleGuideError:
    """The error with the names of arguments in place of options and of the file that the records went through."""

    def place(match: re.Match[str]) -> str:
        return f"summaries[{places[int(match.group(1)) - 1]}]"

    stated = error.message.removeprefix("cannot analyse the population: ")
    message = re.sub(re.escape(own) + r":(\d+)(:\d+)?", place, stated)
    for option, name in _OPTIONS.items():
        message = message.replace(f"--{option}", name)
    if message == stated:
        return error
    return ArgumentError(message, field=error.field)
