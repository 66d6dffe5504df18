import json

import numpy as np

from calib.report.html.look import add_matrix, as_json, filled, name_axis, new, scalar_json, shown, wrapped


def test_nothing_ends_the_script_that_holds_a_figure():
    odd = "</script><!-- & ]]>"
    figure = new(300, title={"text": odd})
    for text in (as_json(figure), scalar_json({"name": odd})):
        assert "<" not in text and ">" not in text and "&" not in text
    assert json.loads(as_json(figure))["layout"]["title"]["text"] == odd


def test_no_theme_of_plotly_is_embedded():
    assert "template" not in json.loads(as_json(new(300)))["layout"] or len(as_json(new(300))) < 1000


def test_names_that_look_like_numbers_stay_names():
    axis = name_axis(["1", "02", "1e3"], reverse=True)
    assert axis["ticktext"] == ["1", "02", "1e3"] and axis["tickvals"] == [0, 1, 2] and axis["range"] == [2.5, -0.5]


def test_text_is_shown_literally():
    assert shown("a<b> & c") == "a&lt;b&gt; &amp; c"
    assert wrapped("one two three four", 9) == "one two<br>three<br>four" and wrapped("<i>", 9) == "&lt;i&gt;"


def test_cells_of_a_matrix_keep_their_places():
    figure = new(300)
    values = np.array([[0.1, np.nan], [0.3, 0.4]])
    cells = [["0.1", ""], ["0.3", "0.4"]]
    add_matrix(figure, values, ["a", "b"], ["x", "y"], cells, colours="Blues", span=(0, 1), label="v")
    (trace,) = figure.data
    np.testing.assert_array_equal(trace.z, values)
    assert trace.hovertext[1][1] == "b, y: 0.4" and trace.hovertext[0][1] == "a, y: no value"


def test_stages_differ_without_colours():
    assert filled("#000", "/")["pattern"]["shape"] == "/" and filled("#000")["pattern"]["shape"] == ""
