"""Results are those of the command line."""

from __future__ import annotations

import copy
import json
import pathlib
import pickle
import subprocess

import numpy as np
import pytest

import needle_guide
from needle_guide import Quantity, Result, Session


def printed(guide: str, *arguments: str) -> object:
    """The JSON document that the program prints."""
    run = subprocess.run([guide, *arguments, "--json"], capture_output=True, text=True, check=True)
    return json.loads(run.stdout)


@pytest.mark.parametrize(
    ("command", "arguments"),
    [
        ("check", {}),
        ("identify", {}),
        ("identify", {"poisson": 0.45, "foundation": "springs", "nuisance": ["rig.backlash"], "bootstrap": 20}),
        ("predict", {"until_mm": 40.0, "to_mm": 80.0}),
        ("track", {"compare": True}),
    ],
)
def test_documents_are_those_of_the_command_line(
    guide: str, example: Session, command: str, arguments: dict[str, object]
) -> None:
    options = []
    for name, value in arguments.items():
        option = "--" + {"until_mm": "until", "to_mm": "to"}.get(name, name)
        values = value if isinstance(value, list) else [value]
        options += [option] if value is True else [part for one in values for part in (option, str(one))]
    found: Result = getattr(example, command)(**arguments)
    assert found.to_dict() == printed(guide, command, str(example.path), *options)


def test_a_diagnosis_is_that_of_the_command_line(guide: str, example: Session) -> None:
    steps: list[str] = []
    found = example.diagnose(on_step=steps.append)
    assert steps, "every step is reported"
    assert found.to_dict() == printed(guide, "diagnose", str(example.path))
    assert found.verdict == "ambiguous"
    assert {"tissue.gradient", "tissue.layers"} <= set(found.effects[0].competing)
    assert set(found.plot()) == {"residuals", "gap", "ranking"}


def test_a_record_is_that_of_the_command_line(guide: str, example: Session, tmp_path: pathlib.Path) -> None:
    file = tmp_path / "all.jsonl"
    subprocess.run([guide, "summarize", example.path, "--out", file], check=True, capture_output=True)
    assert file.read_text(encoding="utf-8") == example.summarize().to_json() + "\n"


def test_figures_are_those_of_the_command_line(guide: str, example: Session, tmp_path: pathlib.Path) -> None:
    found = example.identify(foundation="springs", profile=True)
    subprocess.run(
        [guide, "identify", example.path, "--foundation", "springs", "--plots", tmp_path],
        check=True,
        capture_output=True,
    )
    written = {path.stem: path.read_text(encoding="utf-8") for path in tmp_path.glob("*.svg")}
    assert dict(found.plot()) == written
    assert "<svg" in found.plot()._repr_html_()
    with pytest.raises(needle_guide.UsageError, match="d20-1.shape"):
        found.plot("none")


def test_numbers_have_their_interval_and_arrays_are_numpy(example: Session) -> None:
    k = example.identify(foundation="springs").k_kpa
    assert isinstance(k, float) and k.ci95 is not None
    assert k.ci95[0] < k < k.ci95[1]
    assert k.unit == "kPa" and str(k).endswith(")")
    assert pickle.loads(pickle.dumps(k)).ci95 == k.ci95
    one = example.predict().insertions[0]
    assert one.depth_mm.dtype == np.float64
    assert one.tip_y_ci95_mm.shape == (len(one.depth_mm), 2)
    beyond = one.depth_mm > 50.0
    assert (one.tip_y_ci95_mm[beyond, 0] < one.tip_y_mm[beyond]).all()


def test_a_document_is_a_copy(example: Session) -> None:
    found = example.check()
    found.to_dict()["usable"] = False
    assert found.usable
    assert copy.deepcopy(found.to_dict())["usable"]


def test_results_show_themselves_in_notebooks(example: Session) -> None:
    page = example.track()._repr_html_()
    assert page.startswith("<table>") and "stiffness of s1" in page
    assert str(Quantity(1.0)) == "1.00"


def test_a_population_is_that_of_the_command_line(guide: str, example: Session, tmp_path: pathlib.Path) -> None:
    # One record under several names: what is compared is the way through Python.
    line = example.summarize().to_json()
    records = []
    for number in range(6):
        record = json.loads(line)
        record["session"] = f"s{number}"
        record["tissue"] = "gel" if number < 3 else "liver"
        record["result"]["ln_k_kpa"] += 0.1 * number
        records.append(needle_guide.Summary(json.dumps(record)))
    file = tmp_path / "all.jsonl"
    file.write_text("".join(record.to_json() + "\n" for record in records), encoding="utf-8")
    found = needle_guide.population(records, by="tissue")
    assert found.to_dict() == printed(guide, "population", str(file), "--by", "tissue")
    assert found.to_dict() == needle_guide.population([file], by=["tissue"]).to_dict()
    assert [group.name for group in found.groups] == ["gel", "liver"]
    assert "k_kpa" in found.prior_toml
    with pytest.raises(needle_guide.UsageError, match="expected at least one"):
        needle_guide.population([])
