"""The templates of the page name only what there is: a name in a branch that no test takes is found here."""

import re
from itertools import pairwise

import pytest
from jinja2 import nodes

from calib.report.html.write import ASKED, OF_SEVERAL, SECTIONS, templates

GIVEN = {"results", "number", "drawing", "file"}
"""What every section is rendered with; see `calib.report.html.write.Contents`."""
OF_THE_PAGE = {"results", "summary", "sections", "style", "scripts"}
TEMPLATES = sorted(name for name in templates().list_templates() if name.endswith(".j2"))


def parsed(name):
    source, _, _ = templates().loader.get_source(templates(), name)
    return templates().parse(source)


def test_every_section_has_a_template_and_a_title():
    assert {name for name in TEMPLATES if name.startswith("section/")} == {
        f"section/{n}.html.j2" for n in (*SECTIONS, *OF_SEVERAL)
    }
    for name in SECTIONS:
        assigned = [node.target for node in parsed(f"section/{name}.html.j2").find_all(nodes.Assign)]
        assert "title" in [target.name for target in assigned if isinstance(target, nodes.Name)], name


def own_names(tree):
    """Names that a template sets, imports or takes as arguments."""
    names = {node.name for node in tree.find_all(nodes.Name) if node.ctx in ("store", "param")}
    names |= {node.name for node in tree.find_all(nodes.Macro)}
    names |= {name for node in tree.find_all(nodes.FromImport) for name in node.names}
    return names | {node.target for node in tree.find_all(nodes.Import)}


@pytest.mark.parametrize("name", TEMPLATES)
def test_every_name_in_a_template_is_there(name):
    tree = parsed(name)
    known = (OF_THE_PAGE if name == "page.html.j2" else GIVEN) | templates().globals.keys() | own_names(tree)
    assert {node.name for node in tree.find_all(nodes.Name) if node.ctx == "load"} - {"loop", "caller"} <= known


@pytest.mark.parametrize("name", TEMPLATES)
def test_every_function_that_a_template_asks_for_is_there(name):
    tree = parsed(name)
    modules = {module: ASKED[module] for module in ASKED.keys() - own_names(tree)}
    for node in tree.find_all(nodes.Getattr):
        if isinstance(node.node, nodes.Name) and node.node.name in modules:
            assert hasattr(modules[node.node.name], node.attr), f"{node.node.name}.{node.attr}"


@pytest.mark.parametrize("name", TEMPLATES)
def test_words_behind_a_tag_at_the_end_of_a_line_do_not_touch_those_before_it(name):
    """The line break behind a tag is removed."""
    source, _, _ = templates().loader.get_source(templates(), name)
    for line, following in pairwise(source.splitlines()):
        if re.search(r"\S.*\{% end(if|for) %\}$", line) and following:
            assert following.startswith(("<", "{%")), line
