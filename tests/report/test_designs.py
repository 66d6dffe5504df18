import numpy as np
import pandas as pd
import pytest

from calib.errors.errors import InputError
from calib.report.design_statistics import correlations, draw_box, draw_history, histograms_figure, nearest_density
from calib.report.designs import MOST_LINES, draw_anthill, draw_parallel


def designs(n, seed=0):
    rng = np.random.default_rng(seed)
    k = rng.normal(size=n)
    table = pd.DataFrame({"design": np.arange(n) + 7, "k": k, "f": k**3 + 0.1 * rng.normal(size=n)})
    return table.assign(objective=np.abs(k)).sort_values("objective", ignore_index=True)


def cloud(ax):
    return next(one for one in ax.collections if one.get_gid() == "designs")


@pytest.mark.parametrize("n", [50, 2000])
def test_a_cloud_has_every_design_with_both_values(n):
    table = designs(n)
    table.loc[3, "f"] = np.nan
    ax = draw_anthill(table, "k", "f", labels={"k": "k, N/m"})
    found, wanted = cloud(ax).get_offsets(), table.loc[table["f"].notna(), ["k", "f"]].to_numpy()
    np.testing.assert_array_equal(np.sort(found, axis=0), np.sort(wanted, axis=0))
    rank = table["k"].corr(table["f"], method="spearman")
    title = ax.get_title(loc="left")
    assert f"{n - 1} designs, 1 without" in title and f"of ranks {rank:+.2f}" in title and ax.get_xlabel() == "k, N/m"


def test_where_designs_crowd_the_cloud_is_darkest():
    table = designs(2000)
    offsets, density = (
        cloud(draw_anthill(table, "k", "f")).get_offsets(),
        cloud(draw_anthill(table, "k", "f")).get_array(),
    )
    assert density.max() == pytest.approx(1.0, abs=0.1) and np.all(np.diff(density) >= 0)
    assert abs(offsets[-1, 0]) < 0.3 and np.abs(offsets[:20, 0]).min() > 1.0


def test_lines_run_between_the_extremes_of_each_axis_and_the_best_are_on_top():
    table = designs(30)
    ax = draw_parallel(table, ["k", "f"], "objective", 2)
    lines = {line.get_gid(): line for line in ax.lines if line.get_gid()}
    assert len(lines) == 30
    low, high = table["k"].min(), table["k"].max()
    for row in table.to_dict("records"):
        height = lines[f"design {row['design']:.0f}"].get_ydata()[0]
        assert height == pytest.approx((row["k"] - low) / (high - low))
    thick = {name for name, line in lines.items() if line.get_linewidth() > 1}
    assert thick == {f"design {design}" for design in table["design"][:2]}


@pytest.mark.medium
def test_of_many_designs_the_best_and_evenly_chosen_ones_are_lines():
    table = designs(3 * MOST_LINES)
    ax = draw_parallel(table, ["k", "f"], "objective", 5)
    drawn = {line.get_gid() for line in ax.lines if line.get_gid()}
    assert len(drawn) <= MOST_LINES and f"{len(drawn)} of {len(table)} designs" in ax.get_title(loc="left")
    assert {f"design {design}" for design in [*table["design"][:5], table["design"].iloc[-1]]} <= drawn


def test_a_column_that_is_not_there_is_named():
    with pytest.raises(InputError, match="column nix"):
        draw_anthill(designs(5), "k", "nix")


def test_correlations_are_linear_of_ranks_and_of_a_parabola():
    rng = np.random.default_rng(3)
    x = rng.uniform(-1.0, 1.0, 4000)
    table = pd.DataFrame({"x": x, "line": 3 * x + 1, "cube": x**3, "square": x**2, "still": 1.0, "k": 10 ** (x + 4)})
    table.loc[:9, "line"] = np.nan
    found = correlations(table, ["x", "k"], ["line", "cube", "square", "still"], log=["k"])
    linear, rank, quadratic = (found[kind].set_index("parameter") for kind in ("linear", "rank", "quadratic"))
    # of a uniform x: cor(x, x^3) = (1/5)/sqrt(1/3 1/7)
    np.testing.assert_allclose(linear.loc["x"], [1.0, np.sqrt(21) / 5, 0.0, np.nan], atol=0.04)
    np.testing.assert_allclose(rank.loc["x"], [1.0, 1.0, 0.0, np.nan], atol=0.04)
    np.testing.assert_allclose(quadratic.loc["x"], [1.0, np.sqrt(21) / 5, 1.0, np.nan], atol=0.04)
    np.testing.assert_allclose(linear.loc["k"], linear.loc["x"], atol=1e-9)


@pytest.mark.parametrize(("kind", "power"), [("normal", 0), ("log-normal", 1), ("uniform", 2)])
def test_the_nearest_density_is_that_of_the_samples(kind, power):
    rng = np.random.default_rng(1)
    drawn = [rng.normal(50.0, 2.0, 3000), rng.lognormal(0.0, 0.8, 3000), rng.uniform(2.0, 5.0, 3000)][power]
    name, density = nearest_density(drawn)
    assert name == kind and density.cdf(np.median(drawn)) == pytest.approx(0.5, abs=0.03)


def test_histograms_leave_out_what_never_changes():
    table = designs(400).assign(still=2.0)
    figure = histograms_figure(table, ["k", "f", "still"], {"k": "k, N/m"})
    shown = [ax for ax in figure.axes if ax.get_visible()]
    assert [ax.get_title(loc="left").splitlines()[0] for ax in shown] == ["k, N/m", "f"]
    for ax, name in zip(shown, ["k", "f"], strict=True):
        bars = [patch for patch in ax.patches if patch.get_gid() == "designs"]
        assert sum(bar.get_height() * bar.get_width() for bar in bars) == pytest.approx(1.0)
        assert bars[0].get_x() == pytest.approx(table[name].min())


def test_the_history_has_the_best_so_far_and_the_middle_half():
    rng = np.random.default_rng(2)
    table = pd.DataFrame({
        "case": np.repeat(["A", "B", "other"], 40), "generation": [*np.tile(np.arange(1, 5), 20), *[np.nan] * 40],
        "objective": rng.uniform(1.0, 2.0, 120),
    })  # fmt: skip
    ax = draw_history(table)
    lines = {line.get_gid(): line for line in ax.lines}
    assert set(lines) == {"best A", "best B"}
    own = table[table["case"] == "A"].groupby("generation")["objective"]
    np.testing.assert_allclose(lines["best A"].get_ydata(), own.min().cummin())
    (band,) = (one for one in ax.collections if one.get_gid() == "spread A")
    assert band.get_paths()[0].vertices[:, 1].max() == pytest.approx(own.quantile(0.75).max())


def test_boxes_are_places_between_the_limits():
    table = pd.DataFrame({"a": np.linspace(1.0, 3.0, 21), "k": np.geomspace(10.0, 1000.0, 21)})
    limits = pd.DataFrame(
        {"parameter": ["a", "k"], "lower": [0.0, 1.0], "upper": [4.0, 1e4], "scale": ["linear", "log"]}
    )
    ax = draw_box(table, limits, 3)
    whole, best = (np.array(one.get_segments())[:, :, 0] for one in ax.collections)
    np.testing.assert_allclose(whole, [[0.25, 0.75], [0.25, 0.75]])
    np.testing.assert_allclose(best, [[0.25, 0.3], [0.25, 0.3]])
    assert [tick.get_text() for tick in ax.get_yticklabels()] == ["a", "k (log)"]
