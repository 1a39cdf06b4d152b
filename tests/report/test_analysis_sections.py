"""The numbers of an analysis, each with its unit and its meaning."""

from dssc_jax.report.analysis_sections import tables
from dssc_jax.results.fields import FieldMeaning

FIELDS = (
    FieldMeaning("seconds", "s", "computing time"),
    FieldMeaning("share", "1", "share of draws"),
    FieldMeaning("loops.NAME.delay", "s", "delay margin"),
    FieldMeaning("ranges[].low", "m", "lower end"),
    FieldMeaning("witness", "", "value of each number"),
    FieldMeaning("draws", "1", "number of draws"),
)
MEANINGS = {field.key: field for field in FIELDS}


def text_of(content):
    """The tables of a summary as HTML."""
    return "".join(str(table) for table in tables("Title", content, MEANINGS))


def test_a_number_has_meaning_and_unit():
    text = text_of({"seconds": 1.5, "share": 0.25})
    assert '<span class="meaning">computing time [s]</span>' in text
    assert '<span class="meaning">share of draws</span>' in text


def test_rows_of_a_group_share_the_meaning_of_their_columns():
    text = text_of({"loops": {"inner": {"delay": 0.1}, "outer": {"delay": 0.2}}, "ranges": [{"low": 1.0}]})
    assert text.count('<span class="meaning">delay margin [s]</span>') == 1
    assert text.count('<span class="meaning">lower end [m]</span>') == 1


def test_entries_of_a_mapping_of_numbers_have_its_meaning():
    assert text_of({"witness": {"k_p": 1.0, "a_p": 2.0}}).count("value of each number") == 2


def test_a_part_without_meanings_takes_none_from_outside():
    assert "number of draws" not in text_of({"integration": {"draws": 16}})
