"""The package that estimates poles, which is an optional extra."""

import importlib.util

import pytest


def pytest_collection_modifyitems(items):
    if importlib.util.find_spec("sdypy") is None:
        for item in items:
            if "modal_analysis" in str(item.path):
                item.add_marker(pytest.mark.skip(reason="needs sdypy-EMA: pip install calib[modes]"))
