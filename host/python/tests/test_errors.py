"""Errors name what is wrong, where, and what is valid."""

from __future__ import annotations

import multiprocessing
import os
import pathlib
import pickle
import shutil
import signal
import subprocess
import sys
import threading
from typing import Any

import numpy as np
import pandas
import pytest

import needle_guide
from needle_guide import AnalysisError, FileError, NeedleGuideError, Session, UsageError, forward

NEEDLE = {"youngs_modulus_gpa": 200.0, "outer_diameter_mm": 1.27, "inner_diameter_mm": 1.0}
RIG = {"guide2_mm": 60.0, "entry_mm": 70.0}


def lateral(k_kpa: float = 12.0, **changes: Any) -> dict[str, Any]:
    """A lateral run of five holds, without noise."""
    levels = np.repeat(np.array([0.0, 0.4, 0.8, 1.2, 0.0]), 60)
    time_s = 0.05 * np.arange(len(levels))
    force_n = forward.force_n(k_kpa=k_kpa, depth_mm=30.0, displacement_mm=levels)
    z_mm = np.arange(71.0, 100.0, 2.0)
    at_s = np.concatenate([np.linspace(3.0 * hold + 1.0, 3.0 * hold + 2.8, len(z_mm)) for hold in range(5)])
    level = np.repeat(np.array([0.0, 0.4, 0.8, 1.2, 0.0]), len(z_mm))
    shape_mm = level * np.tile(forward.deflection_mm(z_mm, k_kpa=k_kpa, depth_mm=30.0), 5)
    run: dict[str, Any] = {
        "id": "d30-1",
        "depth_mm": 30.0,
        "force": {"time_s": time_s, "displacement_y_mm": levels, "force_y_n": force_n},
        "shape": {"time_s": at_s, "z_mm": np.tile(z_mm, 5), "deflection_y_mm": shape_mm},
    }
    return {**run, **changes}


NOISE = {"force_n": 0.02, "displacement_mm": 0.01, "shape_mm": 0.025}


def test_a_session_from_arrays_gives_the_modulus_it_was_made_with() -> None:
    session = Session.from_arrays(needle=NEEDLE, rig=RIG, noise=NOISE, lateral=[lateral()])
    k = session.identify(foundation="springs").k_kpa
    # What is stated of the rig is known to its tolerances, so that the posterior's mean is off by a part of its interval.
    assert k.ci95 is not None
    low, high = k.ci95
    assert low < 12.0 < high
    assert k == pytest.approx(12.0, rel=1e-2)


def test_a_data_frame_is_as_good_as_arrays() -> None:
    run = lateral()
    frames = {name: pandas.DataFrame(run[name]) for name in ("force", "shape")}
    one = Session.from_arrays(needle=NEEDLE, rig=RIG, noise=NOISE, lateral=[run]).identify()
    other = Session.from_arrays(needle=NEEDLE, rig=RIG, noise=NOISE, lateral=[{**run, **frames}]).identify()
    assert one.to_dict() == other.to_dict()


def changed(table: str, **columns: Any) -> dict[str, Any]:
    run = lateral()
    run[table] = {**run[table], **columns}
    return run


@pytest.mark.parametrize(
    ("run", "message"),
    [
        (changed("force", force_y_n=np.zeros(299)), r"lateral\[0\]: force.force_y_n: 299 values, expected 300 as time_s has"),
        (changed("force", force_y_n=np.zeros((300, 1))), r"force.force_y_n: shape \(300, 1\), expected one dimension"),
        (changed("force", force_y_n=np.full(300, np.nan)), r"force.force_y_n: value 0 is not finite"),
        (changed("force", force_y_n=["a"] * 300), r"force.force_y_n: holds something else than numbers"),
        (changed("force", force_y_mn=np.zeros(300)), r"force.force_y_mn: is not known, expected force_y_n: the unit is part"),
        (changed("shape", z_m=np.zeros(75)), r"shape.z_m: is not known, expected z_mm: the unit is part of the name"),
        ({**lateral(), "force": {"time_s": [0.0]}}, r"force.displacement_y_mm: missing"),
        ({"id": "a", "depth_mm": 1.0, "force": {}}, r"lateral\[0\]: shape: missing"),
        ({**lateral(), "force": [1.0]}, r"lateral\[0\]: force: list, expected a mapping"),
        ({**lateral(), "depth_m": 0.03}, r"lateral\[0\]: depth_m: is not known, expected depth_mm: the unit is part"),
    ],
)
def test_a_wrong_array_is_named(run: dict[str, Any], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        Session.from_arrays(needle=NEEDLE, rig=RIG, lateral=[run])


def test_what_is_masked_is_missing() -> None:
    masked = np.ma.MaskedArray(lateral()["force"]["force_y_n"], mask=np.arange(300) == 7)
    with pytest.raises(UsageError, match=r"lateral\[0\]: force.force_y_n: value 7 is masked"):
        Session.from_arrays(needle=NEEDLE, rig=RIG, lateral=[changed("force", force_y_n=masked)])


def test_a_record_of_a_session_from_arrays_has_its_name() -> None:
    named = Session.from_arrays(needle=NEEDLE, rig=RIG, noise=NOISE, lateral=[lateral()], name="gel 3, second day")
    assert named.summarize().session == "gel 3, second day"


def test_a_session_from_arrays_states_its_date_and_site() -> None:
    own = Session.from_arrays(
        needle=NEEDLE, rig=RIG, noise=NOISE, lateral=[lateral()], subject={"id": "p1"}, date="2026-03-01", site="north"
    )
    record = own.summarize().to_dict()
    assert (record["date"], record["site"], record["subject"]) == ("2026-03-01", "north", "p1")
    with pytest.raises(needle_guide.ArgumentError, match="1 March") as caught:
        Session.from_arrays(needle=NEEDLE, rig=RIG, lateral=[lateral()], date="1 March")
    assert "needle-guide-" not in str(caught.value) and caught.value.path is None


def test_two_runs_of_one_id_are_rejected() -> None:
    with pytest.raises(UsageError, match=r'lateral\[1\]: id: "d30-1" is there twice'):
        Session.from_arrays(needle=NEEDLE, rig=RIG, lateral=[lateral(), lateral()])


def test_a_field_in_another_unit_is_rejected() -> None:
    with pytest.raises(UsageError, match="outer_diameter_m: not part of the format"):
        Session.from_arrays(needle={**NEEDLE, "outer_diameter_m": 1.27e-3}, rig=RIG, lateral=[lateral()])
    # A number that is in range of no unit but the wrong one.
    with pytest.raises(FileError, match="guide2_mm") as caught:
        Session.from_arrays(needle=NEEDLE, rig={**RIG, "guide2_mm": 0.06}, lateral=[lateral()])
    assert caught.value.field is not None and "guide2_mm" in caught.value.field


def test_a_fault_in_a_file_has_its_place(example: Session, tmp_path: pathlib.Path) -> None:
    path = tmp_path / "session"
    shutil.copytree(example.path, path)
    table = path / "i1.csv"
    lines = table.read_text(encoding="utf-8").splitlines()
    lines[3] = lines[3].replace(",", ",x", 1)
    table.write_text("\n".join(lines) + "\n", encoding="utf-8")
    for call in (lambda: Session.open(path), lambda: Session(path).predict()):
        with pytest.raises(FileError) as caught:
            call()
        assert (caught.value.path, caught.value.line) == (str(table), 4)
        assert caught.value.column is not None and caught.value.field
    finding = Session(path).check().findings[0]
    assert (finding.severity, finding.file, finding.line) == ("error", str(table), 4)


def test_a_session_that_is_deleted_meanwhile_is_an_error(example: Session, tmp_path: pathlib.Path) -> None:
    path = tmp_path / "session"
    shutil.copytree(example.path, path)
    session = Session.open(path)
    stop = threading.Event()
    outcomes: list[BaseException | None] = []

    def identify() -> None:
        while not stop.is_set():
            try:
                session.track()
                outcomes.append(None)
            except BaseException as error:  # noqa: BLE001 - looked at below
                outcomes.append(error)
                return

    reader = threading.Thread(target=identify)
    reader.start()
    while not outcomes:
        pass
    shutil.rmtree(path)
    reader.join()
    stop.set()
    assert isinstance(outcomes[-1], FileError), outcomes[-1]
    assert "cannot read" in outcomes[-1].message
    assert session.summarize().error is not None


def test_errors_form_one_tree_and_cross_processes(example: Session) -> None:
    classes = (UsageError, FileError, AnalysisError, needle_guide.DeviceError, needle_guide.InternalError)
    assert all(issubclass(one, NeedleGuideError) for one in classes)
    with pytest.raises(UsageError, match="expected 0 to 0.5") as caught:
        example.identify(poisson=3.0)
    assert isinstance(caught.value, ValueError)
    error = FileError("a", "b", 1, 2, "c", "d")
    again = pickle.loads(pickle.dumps(error))
    assert (again.message, again.path, again.line, again.field) == ("a", "b", 1, "c")


def test_what_the_data_do_not_allow_is_an_analysis_error() -> None:
    path = {"depth_mm": np.arange(80.0), "tip_y_mm": np.zeros(80)}
    session = Session.from_arrays(needle=NEEDLE, rig=RIG, insertion=[{"id": "i1", "path": path}])
    with pytest.raises(AnalysisError, match="lateral: missing"):
        session.identify()


def test_an_exception_of_a_callback_ends_the_call(example: Session) -> None:
    def fail(step: str) -> None:
        raise LookupError(step)

    with pytest.raises(LookupError):
        example.diagnose(on_step=fail)


def test_ctrl_c_ends_a_call(example: Session) -> None:
    """The result of the diagnosis is never printed: the interrupt comes with its first step."""
    code = (
        "import os, signal, sys\n"
        "from needle_guide import Session\n"
        "def step(name):\n"
        "    os.kill(os.getpid(), signal.SIGINT)\n"
        "try:\n"
        "    Session(sys.argv[1]).diagnose(on_step=step)\n"
        "    print('done')\n"
        "except KeyboardInterrupt:\n"
        "    print('interrupted')\n"
    )
    run = subprocess.run([sys.executable, "-c", code, example.path], capture_output=True, text=True, check=True)
    assert run.stdout == "interrupted\n", run.stderr
    assert run.stderr == ""


def test_the_forward_model_is_interrupted_between_sets() -> None:
    code = (
        "import os, signal, threading\n"
        "import numpy as np\n"
        "from needle_guide import forward\n"
        "threading.Timer(0.3, lambda: os.kill(os.getpid(), signal.SIGINT)).start()\n"
        "try:\n"
        "    while True:\n"
        "        forward.force_jacobian(forward.PARAMETERS, k_kpa=np.linspace(1, 9, 1_000_000), depth_mm=30.0)\n"
        "except KeyboardInterrupt:\n"
        "    print('interrupted')\n"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout == "interrupted\n", run.stderr


def test_calls_work_from_threads_and_spawned_processes(example: Session) -> None:
    expected = example.track().to_dict()
    found: list[object] = []
    threads = [threading.Thread(target=lambda: found.append(example.track().to_dict())) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found == [expected] * 3
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        record = pool.map(needle_guide.summarize, [os.fspath(example.path / "none")])[0]
    assert record.error is not None


def test_the_program_of_the_wheel_has_its_exit_codes(guide: str, example: Session) -> None:
    def code(*arguments: object) -> int:
        return subprocess.run([guide, *map(str, arguments)], capture_output=True, check=False).returncode

    assert code("check", example.path) == 0
    assert code("check", "/nonexistent") == 1
    assert code("check", "--nonsense") == 2
    assert code("--help") == 0
    # A reader that goes away is no error.
    run = subprocess.run(f"'{guide}' effects | head -1", shell=True, capture_output=True, text=True, check=True)
    assert run.stdout.startswith("tissue.") and run.stderr == ""
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
