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
    assert found.to_dict() == needle_guide.population(str(file), by=["tissue"]).to_dict()
    with pytest.raises(needle_guide.UsageError, match="expected at least one"):
        needle_guide.population([])


@pytest.fixture(scope="module")
def many(example: Session) -> list[needle_guide.Summary]:
    """Five subjects with three sessions each, one of them far off."""
    line = example.summarize().to_json()
    records = []
    for number in range(15):
        record = json.loads(line)
        record.update(session=f"s{number:02}", subject=f"p{number // 3}", date="2026-03-01")
        record["result"].update(named=[], verdict="adequate", ln_k_sd=0.03)
        record["result"]["ln_k_kpa"] = 2.0 + 0.1 * (number // 3) + 0.02 * (number % 3) + (0.9 if number == 7 else 0.0)
        records.append(needle_guide.Summary(json.dumps(record)))
    return records


def test_a_population_has_typed_parts(many: list[needle_guide.Summary]) -> None:
    found = needle_guide.population(many)
    group = found.groups[0]
    assert [level.name for level in group.levels] == ["subject", "session"]
    subject, session = group.levels
    assert subject.groups == 5 and subject.degrees_of_freedom == 4
    assert subject.tau is not None and subject.tau.ci95 is not None and subject.icc is not None
    assert session.tau is not None and session.icc is None
    assert group.new_subject95_kpa is not None and group.new_subject95_kpa[0] < group.k_kpa
    assert [one.session for one in found.listed_sessions] == ["s07"] and 0.0 < found.listed_sessions[0].weight < 0.2
    row = found.rows[7]
    assert row.residual is not None and row.residual > 5.0 and row.used and str(row.date) == "2026-03-01"
    flat = needle_guide.population(many, independent=True)
    assert "15 sessions of 5 subjects" in flat.warnings[0]


def test_results_are_tables_draws_and_figures(example: Session, many: list[needle_guide.Summary]) -> None:
    pytest.importorskip("pandas")
    found = needle_guide.population(many)
    table = found.to_dataframe()
    assert len(table) == 15 and {"k_low_kpa", "k_kpa", "k_high_kpa", "weight"} <= set(table.columns)
    identified, predicted = example.identify(), example.predict()
    assert list(identified.to_dataframe()["run"]) == [run.id for run in identified.runs]
    assert len(predicted.to_dataframe()) == sum(len(one.depth_mm) for one in predicted.insertions)
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("Agg")
    from matplotlib import pyplot

    _, axes = pyplot.subplots(1, 5)
    tracked = example.track()
    drawn = [
        identified.runs[0].plot_shape(ax=axes[0]),
        predicted.insertions[0].plot_path(ax=axes[1]),
        tracked.runs[0].plot_stiffness(ax=axes[2]),
        found.plot_forest(ax=axes[3]),
        found.plot_levels(ax=axes[4]),
    ]
    assert all(one is ax for one, ax in zip(drawn, axes, strict=True))
    assert all(ax.has_data() and ax.get_xlabel() for ax in axes)
    assert len(axes[3].get_yticklabels()) == 16
    pyplot.close("all")


def test_draws_have_the_interval_of_the_mean(many: list[needle_guide.Summary]) -> None:
    pytest.importorskip("arviz")
    found = needle_guide.population(many)
    posterior = found.to_arviz().posterior
    assert set(posterior) == {"ln_k_kpa", "tau_subject", "tau_session"}
    ends = np.exp(np.quantile(posterior["ln_k_kpa"].values, [0.025, 0.975]))
    assert ends == pytest.approx(found.groups[0].k_kpa.ci95, rel=0.02)
    with pytest.raises(needle_guide.UsageError, match='group: "liver" is not there, expected one of all'):
        found.to_arviz("liver")


def test_errors_of_a_population_are_about_its_arguments(many: list[needle_guide.Summary], tmp_path: pathlib.Path) -> None:
    with pytest.raises(needle_guide.UsageError, match=r'^summaries\[2\]: session: "s00" is there twice'):
        needle_guide.population([many[0], many[1], many[0]])
    with pytest.raises(needle_guide.UsageError, match='by: "tisue" is stated by no session') as caught:
        needle_guide.population(many, by="tisue")
    assert "--" not in str(caught.value) and str(tmp_path.parent) not in str(caught.value)


def test_parameters_of_effects_have_units(example: Session) -> None:
    units = {value.unit for effect in example.diagnose().effects for value in effect.parameters.values()}
    assert units and units != {""}


def test_the_version_is_that_of_the_program(guide: str) -> None:
    run = subprocess.run([guide, "--version"], capture_output=True, text=True, check=True)
    assert needle_guide.__version__ in run.stdout
