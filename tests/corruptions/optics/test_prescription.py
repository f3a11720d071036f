"""Test reading and writing lens prescription files."""

import json

import pytest

from robustflow.core.errors import DataError
from robustflow.corruptions.optics.lens import read_lens, write_lens

from ...refusals import refused
from .lenses import cooke_triplet


def test_written_prescription_reads_back_equal(tmp_path):
    lens = cooke_triplet()
    write_lens(lens, tmp_path / "lens.json")
    assert read_lens(tmp_path / "lens.json") == lens


def damaged(change):
    content = json.loads(cooke_triplet().model_dump_json())
    change(content)
    return json.dumps(content)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda c: c["surfaces"][0].update(glass="UNOBTAINIUM"), "not in the catalogue"),
        (lambda c: c["surfaces"][0].update(thickness=-1), "greater than or equal to 0"),
        (lambda c: c["surfaces"][0].update(semi_diameter=0), "greater than 0"),
        (lambda c: c["surfaces"][0].update(note="x"), "Extra inputs"),
        (lambda c: c.update(stop=0), "must be a plane in air"),
        (lambda c: c.update(stop=12), "is not one of the 7 surfaces"),
        (lambda c: c["surfaces"][-1].update(glass="N-BK7"), "behind the last surface must be air"),
        (lambda c: c.update(half_field=120), "less than 80"),
        (lambda c: c.pop("f_number"), "Field required"),
    ],
)
def test_a_faulty_prescription_is_refused_in_one_line_that_names_the_fault(tmp_path, change, words):
    path = tmp_path / "lens.json"
    path.write_text(damaged(change))
    with refused(DataError, words):
        read_lens(path)


@pytest.mark.parametrize("content", ["", "[]", "{", '{"name": NaN}', "\x00\x01"])
def test_file_that_is_not_a_prescription_is_refused(tmp_path, content):
    path = tmp_path / "lens.json"
    path.write_text(content)
    with pytest.raises(DataError, match="is not a lens prescription"):
        read_lens(path)


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(DataError, match="cannot read lens prescription"):
        read_lens(tmp_path / "none.json")
