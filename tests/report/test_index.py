"""The index: one row a result, damaged ones among them."""

import os
import shutil
from pathlib import Path

import pytest

import dssc_jax as dj
from dssc_jax.core.errors import ConfigError
from dssc_jax.report import write, write_index
from dssc_jax.report.index import REPORT
from dssc_jax.report.page import is_current
from tests.forging import resealed


@pytest.fixture
def results(ran, tmp_path):
    """A folder of one good result, with a report already."""
    ran.save(tmp_path / "good")
    write(dj.load(tmp_path / "good"), tmp_path / "good" / REPORT, worst=0)
    ran.path = None
    return tmp_path


def trouble(results):
    return {row.folder.name: row.trouble for row in write_index(results)[1]}


def test_a_good_result_is_linked(results, ran):
    made = []
    page, (row,) = write_index(results, made.append)
    text = page.read_text()
    assert 'href="good/report.html"' in text
    assert row.trouble == ""
    assert f"{ran.failed.values.mean():.4g}" in text
    assert made == []


def test_reports_that_are_missing_or_out_of_date_are_made(results):
    page, made = results / "good" / REPORT, []
    page.unlink()
    write_index(results, made.append)
    assert "What was measured" in page.read_text()
    resealed(results / "good", started="2020-01-01T00:00:00+00:00")
    write_index(results, made.append)
    assert made == [page, page]
    write_index(results, made.append)
    assert made == [page, page]


def test_a_page_that_is_not_whole_or_of_another_result_is_made_again(results, swept):
    """However new it is."""
    page = results / "good" / REPORT
    whole = page.read_bytes()
    other = write(swept, results / "other.html", worst=0).read_bytes()
    for content in (
        whole[: len(whole) // 2],
        whole[:-1],
        b"",
        other,
        b"A stranger's page",
        whole.replace(b"e", b"a", 1),
    ):
        made = []
        page.write_bytes(content)
        write_index(results, made.append)
        assert made == [page]
        assert is_current(page, dj.load(results / "good"))
        page.write_bytes(whole)


def test_a_linked_folder_is_not_followed(results, tmp_path_factory):
    elsewhere = tmp_path_factory.mktemp("elsewhere") / "result"
    shutil.copytree(results / "good", elsewhere)
    (elsewhere / REPORT).write_text("precious")
    (results / "linked").symlink_to(elsewhere)
    assert trouble(results) == {"good": "", "linked": "is a symbolic link, which the index does not follow"}
    assert (elsewhere / REPORT).read_text() == "precious"


def test_damage_is_listed_and_nothing_else_changes(results):
    def copied(name):
        return shutil.copytree(results / "good", results / name)

    (results / "empty").mkdir()
    (copied("broken") / "manifest.json").write_text("{")
    (copied("binary") / "manifest.json").write_bytes(b"\xff\xfe\x00")
    next((copied("chunk") / "data.zarr" / "outcome" / "c").rglob("0")).unlink()
    shutil.rmtree(copied("undigested") / "digests")
    shutil.rmtree(copied("hollow") / "data.zarr")
    (results / "hollow" / REPORT).unlink()
    resealed(copied("cut"), complete=False)
    shutil.rmtree(results / "cut" / "digests")
    found = trouble(results)
    assert found.pop("good") == ""
    assert len(found) == 7
    assert all(found.values())
    assert "`resume`" in found["cut"]
    text = (results / "index.html").read_text()
    assert all(f"<code>{name}</code>" in text for name in found)
    assert not (results / "hollow" / REPORT).exists()


def test_numbers_come_from_the_draws(results, ran):
    """summary.json is for people and other programs."""
    summary = results / "good" / "summary.json"
    for said in ('{"points": [{"failures": 0, "draws": 24, "probability": 0.0, "interval": [0.0, 0.1]}]}', "[1]"):
        summary.write_text(said)
        _, (row,) = write_index(results)
        assert row.trouble == ""
        assert row.worst_probability == ran.failed.values.mean()


def test_names_are_text_and_links_are_quoted(results):
    (results / "good").rename(results / "<b>50%# & more")
    text = write_index(results)[0].read_text()
    assert 'href="%3Cb%3E50%25%23%20%26%20more/report.html"' in text
    assert "<code>&lt;b&gt;50%# &amp; more</code>" in text


def test_bytes_that_are_no_text(results):
    """A folder's name that is no UTF-8; half a character in a manifest is damage, and no crash."""
    os.rename(results / "good", os.fsencode(results) + b"/\xff")
    page, (row,) = write_index(results)
    assert row.trouble == ""
    assert b'href="%FF/report.html"' in page.read_bytes()
    manifest = Path(os.fsdecode(os.fsencode(results) + b"/\xff")) / "manifest.json"
    manifest.write_text(manifest.read_text().replace('"uncertain"', '"\\ud800"'))
    _, (row,) = write_index(results)
    assert "is damaged" in row.trouble


def test_one_report_that_fails_does_not_take_the_index_with_it(results, monkeypatch):
    (results / "good" / REPORT).unlink()

    def fail(*arguments):
        raise ArithmeticError("of the unforeseen kind")

    monkeypatch.setattr("dssc_jax.report.index.write", fail)
    assert trouble(results) == {"good": "its report cannot be made: ArithmeticError: of the unforeseen kind"}


def test_results_in_subfolders_are_found(results):
    (results / "deep" / "er").mkdir(parents=True)
    (results / "good").rename(results / "deep" / "er" / "good")
    assert trouble(results) == {"good": ""}


def test_an_empty_folder_and_none(tmp_path):
    page, rows = write_index(tmp_path)
    assert rows == []
    assert "No result" in page.read_text()
    with pytest.raises(ConfigError, match="not a folder of results"):
        write_index(tmp_path / "none")
