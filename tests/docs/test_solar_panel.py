"""The example of Li and Hong (2012) computed anew: its tables, its figures, and the numbers of its page."""

import json
import runpy
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from calib.command import cli
from calib.study.loading import module_of

ROOT = Path(__file__).resolve().parents[2]
STUDY = ROOT / "studies/solar_panel"
PAGE = ROOT / "docs/solar_panel.md"


article, figures = (module_of(STUDY / f"{name}.py") for name in ("article", "article_figures"))


@pytest.fixture(scope="module")
def example():
    return article.Example(article.solar_panel())


@pytest.fixture(scope="module")
def few(example):
    """Runs with three draws of the noise, and their steps."""
    return article.runs(example, 3, article.OFFSET)


# -- what the tables hold ----------------------------------------------------------------------------------------------


def test_every_level_of_the_reduction_is_better_and_none_is_below_the_model(example):
    table = article.reduction(example).pivot(index="level", columns="order", values="error")
    assert table.shape == (5, 8) and table.to_numpy().min() > -1e-6  # %, of rounding
    assert np.all(np.diff(table, axis=0) < 1e-7)
    assert table.loc[0].max() > 1 and table.loc[4].max() < 1e-5


@pytest.mark.slow
def test_without_noise_all_iterations_come_to_the_true_factors(example):
    table = article.noise_free(example)
    last = table[table["step"] == article.STEPS]
    assert len(last) == 6 and last["error"].max() < 1e-3
    first = table[table["step"] == 1].groupby("truth")["error"]
    assert np.all(first.max() - first.min() < 1e-12)  # the correction term is zero in the first step


def test_noise_is_uniform_and_of_the_articles_size(example):
    true = example.measured(article.FACTORS, article.OFFSET)
    draws = [example.noisy(true, seed) for seed in range(30)]
    frf = np.array([d.receptance / true.receptance - 1 for d in draws])
    freq = np.array([d.freq / true.freq - 1 for d in draws])
    for found, size in ((frf, 0.05), (freq, 0.03)):
        assert np.abs(found).max() <= size and np.std(found) == pytest.approx(size / np.sqrt(3), rel=0.15)
    np.testing.assert_array_equal(example.noisy(true, 7).freq, draws[7].freq)


@pytest.mark.slow
def test_tables_follow_from_the_runs(few):
    runs, steps = few
    converged = article.convergence(steps)
    table = article.frequencies(converged).set_index("order")
    last = steps[(steps["step"] == 15) & (steps["iteration"] == "traditional")]
    own = last.assign(size=last["error"].abs()).groupby("order")["size"]
    np.testing.assert_allclose(table["traditional_median"], own.median())
    np.testing.assert_allclose(table["traditional_worst"], own.max())
    found = article.factors(runs).set_index(["iteration", "parameter"]).loc[("proposed", "E_beam_19")]
    values = runs.loc[runs["iteration"] == "proposed", "E_beam_19"]
    assert [found["mean"], found["std"]] == pytest.approx([np.mean(values), np.std(values, ddof=1)])
    largest = runs.set_index(["iteration", "seed"])["largest"]
    assert largest["traditional", 2] == pytest.approx(
        last[(last["seed"] == 2) & (last["order"] <= 6)]["error"].abs().max()
    )


@pytest.mark.slow
def test_equations_are_built_once_or_at_every_step_and_reductions_are_the_same(few):
    table = article.cost(few[0]).set_index("iteration")
    assert table["builds"].to_dict() == {"proposed": 1, "traditional": 15, "traditional_total": 15}
    assert set(table["reductions"]) == {16}


def test_a_run_that_fails_is_a_row_with_its_error(example, monkeypatch):
    def refuse(*_):
        raise article.EvaluationError("the factor of E_panel_1 becomes -1")

    monkeypatch.setattr(article, "cmcf", refuse)
    runs, _ = article.runs(example, 2, 0.02)
    table = article.offsets(runs.assign(first=np.nan, largest=np.nan, **{"settled_0.1": np.nan, "settled_0.5": np.nan}))
    assert len(runs) == 6 and runs["error"].str.contains("E_panel_1").all()
    assert (table["failed"] == table["runs"]).all()


@pytest.mark.parametrize(
    ("errors", "step"), [([3.0, 1.0, 1.05, 1.0], 2), ([1.0, 1.0], 1), ([1.0, 3.0, 1.0], 3), ([1.0, 2.0], 2)]
)
def test_a_run_has_settled_when_no_error_leaves_its_last_value_again(errors, step):
    assert article.settled(np.array(errors)[:, None], 0.1) == step


# -- what the figures show ---------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def drawn_tables(few, example):
    runs, steps = few
    return {
        "reduction": article.reduction(example), "convergence": article.convergence(steps), "runs": runs,
        "factors": article.factors(runs), "functions": article.functions(example, runs),
    }  # fmt: skip


def lines(ax):
    return {line.get_label(): np.column_stack(line.get_data()) for line in ax.get_lines()}


@pytest.mark.slow
def test_lines_are_the_tables(drawn_tables):
    table = drawn_tables["reduction"]
    shown = lines(figures.draw_reduction(None, table))
    np.testing.assert_allclose(shown["0 (Guyan)"][:, 1], table.loc[table["level"] == 0, "error"])
    table = drawn_tables["convergence"]
    panels = figures.convergence_figure(table).axes
    own = table[(table["iteration"] == "traditional") & (table["order"] == 6)]
    assert own["step"].min() == 0
    np.testing.assert_allclose(lines(panels[5])["traditional, worst"], own[["step", "worst"]])
    assert [ax.get_title() for ax in panels] == [f"order {k}" for k in range(1, 7)]
    table = drawn_tables["functions"]
    upper, lower = figures.functions_figure(table).axes
    np.testing.assert_allclose(lines(upper)["initial model"], table[["freq", "before"]])
    np.testing.assert_allclose(lines(lower)["updated model, proposed"], table[["freq", "proposed"]])
    np.testing.assert_allclose(lines(lower)["experiment"], table[["freq", "experiment"]])


@pytest.mark.medium
def test_the_committed_figure_is_that_of_the_present_code(example, tmp_path):
    """Of one figure, whose table takes no time; ``figures.py --check`` asks this of all whose results are at hand."""
    script = runpy.run_path(str(ROOT / "docs/figures.py"))
    table = article.reduction(example)
    (tmp_path / f"{figures.SET.last}.csv").write_text("", "utf-8")
    table.to_csv(tmp_path / "reduction.csv", index=False)
    committed = ROOT / "docs/figures/solar_panel_reduction.png"
    assert script["shows"](committed, figures.SET.drawn(tmp_path, "reduction"))
    table[table["level"] < 4].to_csv(tmp_path / "reduction.csv", index=False)
    assert not script["shows"](committed, figures.SET.drawn(tmp_path, "reduction"))
    assert not script["shows"](tmp_path / "none.png", figures.SET.drawn(tmp_path, "reduction"))


@pytest.mark.slow
def test_dots_are_the_factors_of_the_seeds(drawn_tables):
    runs = drawn_tables["runs"]
    ax = figures.draw_true_factors(figures.draw_factors(None, runs), drawn_tables["factors"])
    dots = [line for line in ax.get_lines() if line.get_marker() == "o"]
    assert len(dots) == 12
    own = runs[runs["iteration"] == "traditional"].sort_values("seed")
    np.testing.assert_allclose(dots[6 + 3].get_ydata(), own["E_beam_18"])
    (true,) = ax.collections
    assert [segment[0, 1] for segment in true.get_segments()] == list(article.FACTORS)


@pytest.mark.slow
def test_figures_are_drawn_from_a_folder_and_from_nothing_else(drawn_tables, tmp_path):
    assert figures.SET.save_all(tmp_path) == []
    for name, table in drawn_tables.items():
        table.to_csv(tmp_path / f"{name}.csv", index=False)
    assert {path.name for path in figures.SET.save_all(tmp_path)} == {f"{name}.png" for name in figures.FIGURES}
    documents = runpy.run_path(str(ROOT / "docs/figures.py"))
    (tmp_path / "solar_panel_article").mkdir()
    assert documents["of_folder"](tmp_path / "solar_panel_article", "factors") is None
    named = {shown.name for shown in documents["FIGURES"].values() if shown.folder == "solar_panel_article"}
    assert named == set(figures.FIGURES)


# -- the numbers of the page -------------------------------------------------------------------------------------------


def cells(*values):
    return "| " + " | ".join(map(str, values)) + " |"


def statements(tables):
    """Lines and words of the page that these tables make."""
    levels = tables["reduction"].pivot(index="level", columns="order", values="error")
    for level, errors in levels.iterrows():
        yield cells(level, *(f"{max(e, 0):.3f}" for e in errors))
    for row in tables["frequencies"].to_dict("records"):
        sizes = (row[f"{i}_{c}"] for i in ("proposed", "traditional") for c in ("median", "worst"))
        yield cells(row["order"], *(f"{size:.1f}" for size in (row["before"], *sizes)))
    factors = tables["factors"].set_index(["iteration", "parameter"])
    for name in article.GROUPS:
        own = [factors.loc[i, name] for i in ("proposed", "traditional")]
        yield cells(f"`{name}`", f"{own[0]['true']:.1f}", *(f"{o['mean']:.2f} ± {o['std']:.2f}" for o in own))
    offsets = tables["offsets"].set_index(["offset", "iteration"])
    for (offset, iteration), row in offsets.iterrows():
        sizes = (f"{row[c]:.1f}" for c in ("first", "median", "worst"))
        steps = (f"{row[c]:g}" for c in ("settled_0.1", "settled_0.5"))
        yield cells(f"{100 * offset:+g} %".replace("-", "−"), iteration.replace("_", ", "), *sizes, *steps)
        assert row["failed"] == 0
    frf, freq = tables["sources"].to_dict("records")
    yield f"{frf['median']:.2f} % (worst {frf['worst']:.2f} %)"
    yield f"{freq['median']:.1f} % (worst {freq['worst']:.1f} %)"
    free = tables["noise_free"]
    yield f"within {free.loc[free['step'] == 15, 'error'].max():.4f} of the true factors"
    cost = tables["cost"].set_index("iteration")
    counts = (cost.loc[i, "builds"] for i in ("proposed", "traditional"))
    yield "built {} time and {} times".format(*counts)


@pytest.mark.slow
def test_the_numbers_of_the_page_are_those_that_are_computed():
    plain, tables = " ".join(PAGE.read_text("utf-8").split()), article.tables()
    assert [words for words in statements(tables) if words not in plain] == []
    six = tables["frequencies"].set_index("order").loc[1:6]
    assert (six[["proposed_worst", "traditional_worst"]].max(axis=1) < six["before"]).all()


def test_the_page_shows_every_figure():
    text = PAGE.read_text("utf-8")
    assert all(f"(figures/solar_panel_{name}.png)" in text for name in (*figures.FIGURES, "study"))


def of_the_study(folder):
    """Words of the page that the study's calibration makes."""
    summary = json.loads((folder / "summary.json").read_text("utf-8"))
    yield f"FRAC rises from {summary['mean_mac_before']:.3f} to {summary['mean_mac_after']:.3f}"
    yield "falls from {:.0f} % to {:.0f} % of".format(
        *(100 * summary[f"mean_freq_error_{s}"] for s in ("before", "after"))
    )
    errors = pd.read_csv(folder / "data_errors.csv").set_index("group")
    used, sensor, band = errors["rms"][["fit", "held_out_sensors", "held_out_bands"]]
    expected = set(errors.loc[["fit", "held_out_sensors", "held_out_bands"], "expected"].round(2))
    yield f"is {used:.2f} standard deviations in the data used, {sensor:.2f} at the validation response and {band:.2f}"
    yield "would show {:.2f}: the verdict is that the model does not fit".format(*expected)
    truth = json.loads((ROOT / "tests/truth/solar_panel.json").read_text("utf-8"))["parameters"]
    found = pd.read_csv(folder / "verdicts.csv").set_index("parameter").loc[list(truth)]
    yield f"off by up to {100 * (found['value'] / pd.Series(truth) - 1).abs().max():.0f} %"
    share = 100 * (found["std"] / found["value"]).max()
    yield f"at most {np.ceil(10 * share) / 10:.1f} % of them"
    assert not found["fits_within_std"].any() and len(expected) == 1


@pytest.mark.slow
def test_the_numbers_of_the_study_are_those_of_its_calibration(undrawn, tmp_path):
    assert cli.execute(["calibrate", str(STUDY), "--workers", "1", "--results", str(tmp_path)]) == 0
    plain = " ".join(PAGE.read_text("utf-8").split())
    assert [words for words in of_the_study(tmp_path / "solar_panel") if words not in plain] == []
