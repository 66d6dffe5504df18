"""The packages that estimate poles, which are optional extras."""

import importlib.util

import pytest

SKIPPED = (
    ("sdypy", pytest.mark.skip(reason="needs sdypy-EMA: pip install calib[modes]")),
    ("pyoma2", pytest.mark.skip(reason="needs pyOMA2: pip install calib[ambient]")),
)


def pytest_collection_modifyitems(items):
    for package, mark in SKIPPED:
        if importlib.util.find_spec(package) is None:
            for item in items:
                of_records = item.path.name == "test_ambient.py"
                if "modal_analysis" in str(item.path) and of_records == (package == "pyoma2"):
                    item.add_marker(mark)
