import numpy as np
import pandas as pd
import pytest

from calib.errors.errors import InputError
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


def test_of_many_designs_the_best_and_evenly_chosen_ones_are_lines():
    table = designs(3 * MOST_LINES)
    ax = draw_parallel(table, ["k", "f"], "objective", 5)
    drawn = {line.get_gid() for line in ax.lines if line.get_gid()}
    assert len(drawn) <= MOST_LINES and f"{len(drawn)} of {len(table)} designs" in ax.get_title(loc="left")
    assert {f"design {design}" for design in [*table["design"][:5], table["design"].iloc[-1]]} <= drawn


def test_a_column_that_is_not_there_is_named():
    with pytest.raises(InputError, match="column nix"):
        draw_anthill(designs(5), "k", "nix")
