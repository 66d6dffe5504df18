import numpy as np
import pytest

from calib.errors.errors import InputError
from calib.measurement.files.csv_format import (
    parse_direction,
    read_modes_csv,
    read_response_units,
    read_responses_csv,
    read_sensor_table,
    read_shapes_csv,
)

HEAD = "mode,freq,freq_kind,freq_std,damping,damping_std\n"


def write(folder, text, name="modes.csv"):
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def test_damped_frequencies_become_natural_ones_with_their_deviation(tmp_path):
    path = write(tmp_path, HEAD + "# a comment\n1BT, 8.0, damped, 0.16, 0.6, 0.01\n\n1BV,12.5,natural,,,\n")
    (repeat,) = read_modes_csv(path).values()
    assert repeat.names == ("1BT", "1BV")
    # sqrt(1 - 0.6**2) = 0.8
    np.testing.assert_allclose(repeat.natural_freq, [10.0, 12.5])
    np.testing.assert_allclose(repeat.freq_std, [0.2, np.nan])
    np.testing.assert_allclose(repeat.damping_ratio, [0.6, np.nan])
    np.testing.assert_allclose(repeat.damping_std, [0.01, np.nan])


def test_columns_of_deviations_and_damping_may_be_absent(tmp_path):
    (repeat,) = read_modes_csv(write(tmp_path, "\ufefffreq_kind,mode,freq\ndamped,a,3\n")).values()
    assert repeat.natural_freq.tolist() == [3.0]
    assert np.isnan(repeat.damping_ratio).all()


@pytest.mark.parametrize(
    ("text", "where"),
    [
        ("", "it is empty"),
        (HEAD, "no rows"),
        (HEAD + "a,1,natural,,1.0,\n", "line 2, column damping: damping ratio 1 is outside"),
        (HEAD + "a,1,natural,,-0.01,\n", "line 2, column damping"),
        (HEAD + "a,nan,natural,,,\n", "line 2, column freq: 'nan' is not a number"),
        (HEAD + "a,1e999,natural,,,\n", "line 2, column freq"),
        (HEAD + "a,1_0,natural,,,\n", "line 2, column freq"),
        (HEAD + "a,0,natural,,,\n", "line 2, column freq"),
        (HEAD + "a,,natural,,,\n", "line 2, column freq: it is empty"),
        (HEAD + "a,1,angular,,,\n", "line 2, column freq_kind"),
        (HEAD + "a,1,natural,0,,\n", "line 2, column freq_std"),
        (HEAD + "a,0.05,natural,12.5,,\n", "line 2, column freq_std"),
        (HEAD + "a,1,natural,1e-300,,\n", "line 2, column freq_std"),
        (HEAD + "a,1,natural,1e300,,\n", "line 2, column freq_std"),
        (HEAD + "a,1,natural,,0.01,1e300\n", "line 2, column damping_std"),
        (HEAD + "a,1,natural,,,\n# c\na,2,natural,,,\n", "line 4, column mode: mode 'a' appears twice"),
        (HEAD + "a,1,natural\n", "line 2, column freq_std: it has 3 entries"),
        (HEAD + 'a,"1,natural,,,\n', "line 2"),
        ("mode,freq\na,1\n", "column 'freq_kind' is missing"),
        (HEAD.replace("\n", ",colour\n") + "a,1,natural,,,,red\n", "unknown column 'colour'"),
        (HEAD.replace(",", "|") + "a|1|natural|||\n", "column 'mode' is missing"),
        ("mode,freq,freq_kind,freq\na,1,natural,1\n", "column 'freq' appears twice"),
        (HEAD.encode() + b"a,1,natural,,\xff,\n", "line 2: byte 14 is not UTF-8"),
        (b"\x89PNG\r\n\x1a\n\x00\x00", "line 1"),
        (b"\x00\x01\x02", "line 1"),
    ],
)
def test_a_mistake_in_the_modes_table_is_named(tmp_path, text, where):
    path = write(tmp_path, text)
    with pytest.raises(InputError) as caught:
        read_modes_csv(path)
    assert str(path) in str(caught.value)
    assert where in str(caught.value)


@pytest.mark.parametrize(
    ("text", "expected"),
    [("x", ("x", 1)), ("-y", ("y", -1)), ("+Z", ("z", 1)), ("-RZ", ("rz", -1)), ("2", ("y", 1)), ("-6", ("rz", -1))]
    + [(text, None) for text in ("", "-", "7", "0", "--1", "xy")],
)
def test_directions(text, expected):
    assert parse_direction(text) == expected


def test_a_negative_direction_turns_the_shape(tmp_path):
    path = write(tmp_path, "mode,node,direction,re,im,std\na,1,y,1,0.5,0.1\na,2,-y,1,0.5,\nb,2,-2,3,,\n", "shapes.csv")
    given = read_shapes_csv(path, {"": ("a", "b")})[""]
    assert given.sensors == ((1, "y"), (2, "y"))
    np.testing.assert_allclose(given.shapes, [[1 + 0.5j, np.nan], [-1 - 0.5j, -3]])
    np.testing.assert_allclose(given.std, [[0.1, np.nan], [np.nan, np.nan]])


@pytest.mark.parametrize(
    ("lines", "where"),
    [
        ("c,1,y,1\n", "line 2, column mode: unknown mode 'c'; the modes are a, b"),
        ("a,1,y,1\na,1,-2,1\n", "line 3, column direction: sensor 1y is given twice for mode a"),
        ("a,1,q,1\n", "line 2, column direction"),
        ("a,1.5,y,1\n", "line 2, column node"),
        ("a,1,y,one\n", "line 2, column re"),
        ("a,1,y,1e200\n", "line 2, column re"),
        ("a,1,y,0\na,2,y,0\n", "shape of mode 'a' is zero"),
    ],
)
def test_a_mistake_in_the_shapes_table_is_named(tmp_path, lines, where):
    path = write(tmp_path, "mode,node,direction,re\n" + lines)
    with pytest.raises(InputError) as caught:
        read_shapes_csv(path, {"": ("a", "b")})
    assert str(path) in str(caught.value)
    assert where in str(caught.value)


def test_the_sensor_table_gives_places_and_parts(tmp_path):
    path = write(tmp_path, "node,x,y,z,on\n1,0,1.5,-2,girder\n2,1,1,1,\n")
    assert read_sensor_table(path) == {1: ((0.0, 1.5, -2.0), "girder"), 2: ((1.0, 1.0, 1.0), None)}
    with pytest.raises(InputError, match="line 3, column node: node 1 is given twice"):
        read_sensor_table(write(tmp_path, "node,x,y,z\n1,0,0,0\n1,0,0,1\n"))


@pytest.mark.parametrize(
    "text",
    [
        "response,value,std\np,1.5,0.1\nq,-2,\n",
        "\ufeffresponse;value;std\r\np;1,5;0,1\r\nq;-2;\r\n;;\r\n",
        "sep=;\nresponse;value;std\n# a; b\np;1,5;,1\nq;-2,;\n",
        'std\tvalue\tresponse\n0.1\t1.5\t"p"\n\t-2\tq\n',
        "response,value,std,,\np,1.5,0.1,,\nq,-2,,,\n",
    ],
)
def test_scalar_responses_as_spreadsheets_save_them(tmp_path, text):
    assert read_responses_csv(write(tmp_path, text)) == {"": {"p": (1.5, 0.1), "q": (-2.0, None)}}


@pytest.mark.parametrize(
    ("lines", "where"),
    [
        ("p,1_000,0.1\n", "line 2, column value"),
        ("p,inf,0.1\n", "line 2, column value"),
        ("p,nan,\n", "line 2, column value"),
        ("p,1e300,\n", "line 2, column value"),
        ("p,1.5,inf\n", "line 2, column std"),
        ("p,1.5,nan\n", "line 2, column std"),
        ("p,1.5,0\n", "line 2, column std"),
        ("p,1.5,1e-300\n", "line 2, column std"),
        ("p,1.5,1e300\n", "line 2, column std"),
        ("p,0,1e-300\n", "line 2, column std"),
        ("p,1.5\n", "line 2, column std: it has 2 entries"),
        ("p,1,5,0,1\n", "line 2, column std: it has 5 entries"),
        ("p,1,0.1\np,2,0.1\n", "line 3, column response"),
        (",1,0.1\n", "line 2, column response"),
        ("p;1.234;0,1\n", "line 2"),
        ("", "no rows"),
    ],
)
def test_a_mistake_in_the_responses_is_named(tmp_path, lines, where):
    path = write(tmp_path, "response,value,std\n" + lines)
    with pytest.raises(InputError) as caught:
        read_responses_csv(path)
    assert str(path) in str(caught.value) and where in str(caught.value)


def test_responses_have_the_units_of_their_column(tmp_path):
    path = write(tmp_path, "repeat,response,value,unit\n1,p,1.5,N\n1,q,2,\n2,p,1.6,N\n2,q,3,mm\n")
    assert read_response_units(path) == {"p": "N", "q": "mm"}
    path = write(tmp_path, "response,value\np,1.5\n")
    assert read_response_units(path) == {} and read_responses_csv(path) == {"": {"p": (1.5, None)}}
    path = write(tmp_path, "repeat,response,value,unit\n1,p,1.5,N\n2,p,1.6,kN\n")
    with pytest.raises(InputError, match="line 3, column unit: response 'p' has the unit 'N' before"):
        read_response_units(path)


def test_decimal_commas_and_points_are_not_mixed(tmp_path):
    with pytest.raises(InputError, match="line 3, column value"):
        read_responses_csv(write(tmp_path, "response;value\np;1,5\nq;1.234\n"))
