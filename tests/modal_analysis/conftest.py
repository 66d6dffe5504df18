"""The package that estimates poles of time records is an optional extra."""

import importlib.util

import pytest


def pytest_collection_modifyitems(items):
    if importlib.util.find_spec("pyoma2") is None:
        for item in items:
            if "modal_analysis" in str(item.path) and item.path.name == "test_ambient.py":
                item.add_marker(pytest.mark.skip(reason="needs pyOMA2: pip install calib[ambient]"))
