"""Actuated needle guide: the modulus of tissue, tip loads and paths of needles, from recorded sessions.

>>> from needle_guide import Session
>>> found = Session.example().identify()
>>> print(found.k_kpa)
17.88 kPa (15.39 to 20.78)
>>> sorted(found.plot())[0]
'd20-1.shape'

Numbers carry their unit in their names, as files and options of the program ``guide`` do, and intervals hold 95 %.
"""

from __future__ import annotations

from importlib.metadata import version as _version

from . import forward
from ._device import SAMPLE, STATES, Device
from ._errors import (
    AnalysisError,
    ArgumentError,
    DeviceError,
    FileError,
    InternalError,
    NeedleGuideError,
    UsageError,
)
from ._many import population, summarize_all
from ._population import (
    Agreement,
    EffectSpread,
    Group,
    Level,
    ListedSession,
    Population,
    SessionRow,
    SharedEffect,
    TipLoad,
)
from ._results import (
    Check,
    Diagnosis,
    Effect,
    Finding,
    Identification,
    IdentifiedRun,
    PredictedInsertion,
    Prediction,
    Summary,
    TrackedRun,
    Tracking,
)
from ._session import Session, call, summarize
from ._values import Figures, Quantity, Result

__version__ = _version("needle-guide")

__all__ = [
    "SAMPLE",
    "STATES",
    "Agreement",
    "AnalysisError",
    "ArgumentError",
    "Check",
    "Device",
    "DeviceError",
    "Diagnosis",
    "Effect",
    "EffectSpread",
    "Figures",
    "FileError",
    "Finding",
    "Group",
    "Identification",
    "IdentifiedRun",
    "InternalError",
    "Level",
    "ListedSession",
    "NeedleGuideError",
    "Population",
    "PredictedInsertion",
    "Prediction",
    "Quantity",
    "Result",
    "Session",
    "SessionRow",
    "SharedEffect",
    "Summary",
    "TipLoad",
    "TrackedRun",
    "Tracking",
    "UsageError",
    "__version__",
    "call",
    "forward",
    "population",
    "summarize",
    "summarize_all",
]
