"""The strict reader of tables: anything ambiguous is refused with its line."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calib.errors.errors import InputError
from calib.results.cell import guarded, guarded_table, number_of, unguarded
from calib.results.results import Results
from calib.results.table import FLAGS, read_rows, read_table


def write(folder, text, name="table.csv"):
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


@pytest.mark.parametrize("text", ["1", "-1", "+1.5", ".5", "1.", "1e3", "-1.5E-3"])
def test_numbers(text):
    assert number_of(text) == float(text)


@pytest.mark.parametrize(
    "text",
    ["", "1_000", "0x1", "1,5", "1.234,5", "1 000", "1\u00a0000", "\uff11\uff12", "nan", "one", "1e", "--1", "1.2.3"],
)
def test_what_is_no_number(text):
    assert number_of(text) is None


def test_decimal_commas():
    assert number_of("-1,5e3", comma=True) == -1500.0 and number_of("12", comma=True) == 12.0
    assert number_of("1.234", comma=True) is None and number_of("1.234,5", comma=True) is None
    assert np.isinf(number_of("inf", comma=True))


@pytest.mark.parametrize(("yes", "no"), [("True", "False"), ("WAHR", "FALSCH"), ("VRAI", "FAUX"), ("1", "0")])
def test_true_and_false_of_spreadsheets(tmp_path, yes, no):
    path = write(tmp_path, f"\ufeffparameter;selected\r\na;{yes}\r\nb;{no}\r\nc;\r\n")
    table = read_table(path, ["parameter"], flags=["selected"])
    assert table["selected"].tolist() == [True, False, None]
    with pytest.raises(InputError, match="line 4"):
        read_table(path, ["parameter"], flags=["selected"], complete=["selected"])


def test_no_word_is_true_and_false():
    assert all(word == word.lower() for word in FLAGS) and set(FLAGS.values()) == {True, False}


@pytest.mark.parametrize("row", ["a,maybe", "a,2", "a,", ",True", "a", "a,True,1"])
def test_a_flag_or_name_in_doubt_is_refused(tmp_path, row):
    path = write(tmp_path, f"parameter,selected\nz,True\n{row}\n")
    with pytest.raises(InputError, match="line 3"):
        read_table(path, ["parameter"], flags=["selected"], complete=["selected"])


def test_rows_that_must_not_be_repeated(tmp_path):
    path = write(tmp_path, "case,parameter,value\nA,k,1\nB,k,2\nA,k,3\n")
    assert len(read_table(path, ["case", "parameter"], ["value"])) == 3
    with pytest.raises(InputError, match="line 4"):
        read_table(path, ["case", "parameter"], ["value"], unique=("case", "parameter"))
    with pytest.raises(InputError, match="line 3"):
        read_table(path, ["case", "parameter"], ["value"], unique="parameter")


def test_a_name_may_begin_like_a_comment(tmp_path):
    path = write(tmp_path, "mode,value\n#1,2\n")
    assert read_table(path, ["mode"], ["value"])["mode"].tolist() == ["#1"]


@pytest.mark.parametrize(
    "text",
    ["=1+1", "+1+cmd|' /C calc'!A0", "-2+3", "@SUM(A1)", "'=1+1", "''@x", "'x", "-1.5", "-", "=", "", "a=b", "+5 %"],
)
def test_a_text_that_a_spreadsheet_would_run_is_guarded_and_read_back(tmp_path, text):
    cell = guarded(text)
    assert cell[:1] not in tuple("=+-@\t\r") or len(cell) < 2 or number_of(cell) is not None
    assert unguarded(cell) == text


@pytest.mark.parametrize("where", ["cell", "column", "row"])
def test_a_text_that_would_run_is_guarded_wherever_it_stands(where):
    words = {place: "=1+1" if place == where else "plain" for place in ("cell", "column", "row")}
    table = pd.DataFrame({words["column"]: [None, words["cell"]], "number": [-1.0, 2.0]}, index=["first", words["row"]])
    safe = guarded_table(table)
    told = {"cell": safe.iloc[1, 0], "column": safe.columns[0], "row": safe.index[1]}
    assert told == {**words, where: "'=1+1"}
    assert pd.isna(safe.iloc[0, 0]) and list(safe["number"]) == [-1.0, 2.0]


def test_a_table_without_such_texts_is_not_copied():
    table = pd.DataFrame({"name": ["a", "-1.5"], "flag": [True, False], "value": [1.0, -2.0]})
    assert guarded_table(table) is table


@given(st.text(alphabet=st.sampled_from("=+-@'ab1. ,;\"\u00e9\u6865"), max_size=8).map(str.strip))
def test_every_text_comes_back_through_a_table(tmp_path_factory, text):
    folder = tmp_path_factory.mktemp("table")
    name = text or "empty"
    table = pd.DataFrame({"parameter": [name, f"{name}_"], "note": [text, ""], f"{name}/": [1.5, -2.5]})
    path = Results(folder).write_table("t", table)
    read = read_table(path, ["parameter"], blank=["note"], others_are_numbers=True)
    assert read["parameter"].tolist() == [name, f"{name}_"]
    assert read["note"].tolist() == ["" if text == "nan" else text, ""]
    assert read[f"{name}/"].tolist() == [1.5, -2.5]


def test_the_index_and_the_header_are_guarded_too_and_numbers_are_not(tmp_path):
    table = pd.DataFrame({"=A1": [-1.0]}, index=pd.Index(["@b"], name="parameter"))
    path = Results(tmp_path).write_table("t", table, index=True)
    assert path.read_text() == "parameter,'=A1\n'@b,-1\n"
    assert read_table(path, ["parameter"], others_are_numbers=True).to_dict("list") == {
        "parameter": ["@b"],
        "=A1": [-1.0],
    }


def test_a_text_of_several_lines_stays_one_cell(tmp_path):
    path = Results(tmp_path).write_table("t", pd.DataFrame({"item": ["a"], "reason": ["one\r\ntwo\tthree"]}))
    assert read_table(path, ["item", "reason"])["reason"].tolist() == ["one two\tthree"]


def test_a_flag_that_a_table_may_lack_is_read_as_a_flag(tmp_path):
    found = read_table(write(tmp_path, "a,b\nx,True\ny,\n"), ["a"], flags=["b", "c"], if_there=["b", "c"])
    assert list(found["b"]) == [True, None] and "c" not in found
    with pytest.raises(InputError, match="maybe"):
        read_table(write(tmp_path, "a,b\nx,maybe\n"), ["a"], flags=["b"], if_there=["b"])


def test_two_spellings_of_one_number_are_one_entry(tmp_path):
    path = write(tmp_path, "freq,value\n0,1\n5,2\n0.0,3\n")
    with pytest.raises(InputError, match=r"'0\.0' twice") as caught:
        read_table(path, [], ["freq", "value"], unique="freq")
    assert caught.value.at.line == 4
    named = write(tmp_path, "case,value\n1,1\n1.0,2\n", "named.csv")
    assert read_table(named, ["case"], ["value"], unique="case")["case"].tolist() == ["1", "1.0"]


@pytest.mark.parametrize("column", ["mode", "repeat", "response"])
def test_a_label_in_two_spellings_of_one_number_is_refused(tmp_path, column):
    with pytest.raises(InputError, match=r"line 4, column .*'0\.0' beside '0'"):
        read_rows(write(tmp_path, f"{column},value\n0,1\n1.0,2\n0.0,3\n"), (column, "value"))
    assert len(read_rows(write(tmp_path, f"{column},value\n0,1\n1.0,2\n0,0.0\na,0\n"), (column, "value"))) == 4


@pytest.mark.parametrize(("text", "node"), [("12", 12), ("12.0", 12), ("12.", 12), ("12.5", None), ("1e1", None)])
def test_a_node_may_be_written_as_a_spreadsheet_does(tmp_path, text, node):
    (row,) = read_rows(write(tmp_path, f"node\n{text}\n"), ("node",))
    if node is None:
        with pytest.raises(InputError, match="node label"):
            row.node()
    else:
        assert row.node() == node


def test_a_column_of_another_name_is_named_with_those_that_are_there(tmp_path):
    with pytest.raises(InputError, match=r"'value'.* mean, std"):
        read_rows(write(tmp_path, "response,mean,std\na,1,2\n"), ("response", "value"), ("std",))
