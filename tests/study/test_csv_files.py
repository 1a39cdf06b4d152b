"""Forms of CSV files: separators, decimal signs, rows that are cut off, and files that are none."""

import csv
import io
import warnings

import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.cli.main import guarded
from dssc_jax.core.errors import ConfigError
from dssc_jax.flight_logs.reading.contents import log_contents
from dssc_jax.study.csv_files import CsvForm, RecordWarning, csv_form, whole_rows
from dssc_jax.study.recorded import recorded_columns
from tests.flight_logs.reading.test_ulog import TAKEOFF

ROWS = [(0.02 * k, np.sin(0.02 * k), -1.5e-3 * k) for k in range(50)]


def text(separator=",", decimal="."):
    """A table by Python's own writer."""
    out = io.StringIO()
    writer = csv.writer(out, delimiter=separator, lineterminator="\n", quoting=csv.QUOTE_MINIMAL)
    writer.writerow(("t", "y", "u_total"))
    writer.writerows([[repr(float(value)).replace(".", decimal) for value in row] for row in ROWS])
    return out.getvalue()


@pytest.mark.parametrize(("separator", "decimal"), [(",", "."), (";", "."), (";", ","), ("\t", "."), ("\t", ",")])
def test_every_form_has_the_same_numbers(tmp_path, separator, decimal):
    path = tmp_path / "log.csv"
    path.write_text(f"# a comment, with commas; and others\n\n{text(separator, decimal)}")
    assert csv_form(path, path.read_bytes()) == CsvForm(separator, decimal)
    log = dj.read_log(path)
    for index, values in enumerate((log.columns["y"].time, log.columns["y"].value, log.columns["u_total"].value)):
        np.testing.assert_array_equal(values, [row[index] for row in ROWS])
    assert recorded_columns(path, ["t", "y"]) == [[row[0] for row in ROWS], [row[1] for row in ROWS]]


def test_a_header_with_two_separators(tmp_path):
    """That which separates header and rows alike; a quoted name may have the other one."""
    path = tmp_path / "log.csv"
    path.write_text("t;y, measured\n0;1\n1;2\n")
    assert csv_form(path, path.read_bytes()) == CsvForm(";", ".")
    path.write_text('t,"y; measured"\n0,1\n1,2\n')
    assert csv_form(path, path.read_bytes()) == CsvForm(",", ".")
    path.write_text("t;y\n0,5;1.5\n")
    with pytest.raises(ConfigError, match=r"decimal commas and with points, as 0,5 and 1\.5: write all with points"):
        csv_form(path, path.read_bytes())


@pytest.mark.parametrize(
    ("content", "told"),
    [
        ("t,y\n0,1\n1\n2,3\n", "has 1 cells in line 3, and 2 in its header: the row is cut off"),
        ("# a road\nt,y\n\n0,0,1,5\n", "has 4 cells in line 4, .* or commas are its decimal signs"),
        ("t;y\n0;1;\n1;2;\n", "has 3 cells in line 2, .* it ends with a separator"),
        ("<html>\nt,y\n0,1\n", "has 2 cells in line 2, and 1 in its header: its first line is no header"),
    ],
)
def test_a_row_with_other_cells_is_named(tmp_path, content, told):
    path = tmp_path / "log.csv"
    path.write_text(content)
    with pytest.raises(ConfigError, match=told):
        dj.read_log(path)
    with pytest.raises(ConfigError, match=told):
        recorded_columns(path, ["t", "y"])


def test_a_last_row_that_is_cut_off_is_left_out(tmp_path):
    path = tmp_path / "log.csv"
    whole = text()
    path.write_text(whole[: whole.rindex(",")])
    with pytest.warns(RecordWarning, match=r"'log.csv' ends within line 51, which is left out"):
        log = dj.read_log(path)
    np.testing.assert_array_equal(log.columns["y"].time, [row[0] for row in ROWS[:-1]])
    with pytest.warns(RecordWarning):
        assert guarded(["log", str(path)]) == 0


def test_a_last_number_that_may_be_cut_off_is_told(tmp_path):
    path = tmp_path / "log.csv"
    whole = "t,y\n0.0,0.125\n0.1,0.250\n0.2,0.375\n"
    path.write_text(whole[:-5])
    with pytest.warns(RecordWarning, match="ends without a line break, so that its last number, 0, may be cut off"):
        assert recorded_columns(path, ["t", "y"])[1][-1] == 0.0
    for sound in (whole, whole[:-1]):
        path.write_text(sound)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            recorded_columns(path, ["t", "y"])


def test_a_spreadsheets_words_for_no_number_are_empty_cells(tmp_path):
    """They begin as a comment does; what follows them in the row counts."""
    path = tmp_path / "log.csv"
    path.write_text("t,y,u_total\n0,1,2\n1,#N/A,3\n2,#DIV/0!,4 # a comment\n3,5,6\n")
    log = dj.read_log(path)
    np.testing.assert_array_equal(log.columns["y"].value, [1.0, 5.0])
    np.testing.assert_array_equal(log.columns["u_total"].value, [2.0, 3.0, 4.0, 6.0])
    assert recorded_columns(path, ["t", "y"]) == [[0.0, 3.0], [1.0, 5.0]]


def test_quoted_cells():
    """A separator or a line break within quotes is none of the table's."""
    content = b't,y,name\n0,1,"a, b"\n1,2,c\n'
    assert whole_rows("a.csv", content, CsvForm()) == content
    content = b't,y,name\n0,1,"a\nb"\n1,2,c\n'
    assert whole_rows("a.csv", content, CsvForm()) == content


def test_a_ulog_by_another_name(tmp_path):
    """It is a log all the same, and no record."""
    pytest.importorskip("pyulog")
    path = tmp_path / "flight.csv"
    path.write_bytes(TAKEOFF.read_bytes())
    assert log_contents(path).topics == log_contents(TAKEOFF).topics
    table = {"signals": {"y": "vehicle_local_position.up"}}
    np.testing.assert_array_equal(
        dj.read_log(path, table=table).columns["y"].value, dj.read_log(TAKEOFF, table=table).columns["y"].value
    )
    with pytest.raises(ConfigError, match=r"is a ULog: `dssc-jax log FILE --topic TOPIC --csv OUT` writes a table"):
        recorded_columns(path, ["t"])


@pytest.mark.parametrize("content", ["t y u_total\n0 1 2.5\n0.02 1e-3 -2\n", "  t   y\n  0   1\n"])
def test_cells_between_blanks_are_told(tmp_path, content):
    path = tmp_path / "log.csv"
    path.write_text(content)
    with pytest.raises(ConfigError, match="has cells that are separated by blanks: separate them by commas"):
        dj.read_log(path)
    path.write_text("the time\n1\n2\n")  # of one column
    assert csv_form(path, path.read_bytes()) == CsvForm()


@pytest.mark.parametrize("content", ["", " \n\n"])
def test_an_empty_table_is_called_empty(tmp_path, content):
    path = tmp_path / "log.csv"
    path.write_text(content)
    with pytest.raises(ConfigError, match=r"log\.csv' is empty$"):
        dj.read_log(path)
