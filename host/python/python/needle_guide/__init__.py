"""Actuated needle guide: the modulus of tissue, tip loads and paths of needles, from recorded sessions.

>>> from needle_guide import Session
>>> found = Session.example().identify()
>>> print(found.k_kpa)
17.11 kPa (14.72 to 19.87)
>>> sorted(found.plot())[0]
'd20-1.shape'

Numbers carry their unit in their names, as files and options of the program ``guide`` do, and intervals hold 95 %.
"""

from __future__ import annotations

from . import forward
from ._device import SAMPLE, STATES, Device
from ._errors import (
    AnalysisError,
    DeviceError,
    FileError,
    InternalError,
    NeedleGuideError,
    UsageError,
)
from ._results import (
    Check,
    Diagnosis,
    Effect,
    Finding,
    Group,
    Identification,
    IdentifiedRun,
    Population,
    PredictedInsertion,
    Prediction,
    Summary,
    TrackedRun,
    Tracking,
)
from ._session import Session, call, population, summarize
from ._values import Figures, Quantity, Result

__all__ = [
    "SAMPLE",
    "STATES",
    "AnalysisError",
    "Check",
    "Device",
    "DeviceError",
    "Diagnosis",
    "Effect",
    "Figures",
    "FileError",
    "Finding",
    "Group",
    "Identification",
    "IdentifiedRun",
    "InternalError",
    "NeedleGuideError",
    "Population",
    "PredictedInsertion",
    "Prediction",
    "Quantity",
    "Result",
    "Session",
    "Summary",
    "TrackedRun",
    "Tracking",
    "UsageError",
    "call",
    "forward",
    "population",
    "summarize",
]
