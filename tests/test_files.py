"""Whole-or-absent writing, and names that stay inside."""

import pytest

from phoslab.errors import PhoslabError
from phoslab.files import inside, replacing, write_text


def test_a_file_that_fails_half_way_leaves_the_old_one_and_nothing_else(tmp_path):
    file = tmp_path / "out.txt"
    write_text(file, "old")

    def fail_half_way():
        with replacing(file) as temporary:
            temporary.write_text("half")
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail_half_way()
    assert file.read_text() == "old"
    assert list(tmp_path.iterdir()) == [file]


def test_a_folder_that_cannot_be_written_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(PhoslabError, match=r"out\.txt: cannot be written"):
        write_text(tmp_path / "file" / "out.txt", "x")


def test_written_files_have_the_permissions_of_other_files(tmp_path):
    (tmp_path / "plain").write_text("")
    write_text(tmp_path / "ours", "")
    assert (tmp_path / "ours").stat().st_mode == (tmp_path / "plain").stat().st_mode


@pytest.mark.parametrize("name", ["../a", "/etc/passwd", "a/../../b", "", "a\\b", "a\0b", "link/a", "link"])
def test_names_that_leave_the_folder_are_refused(tmp_path, name):
    folder = tmp_path / "session"
    folder.mkdir()
    (folder / "link").symlink_to(tmp_path)
    with pytest.raises(PhoslabError, match="journal"):
        inside(folder, name, file=folder / "journal.jsonl", field="frame")


def test_plain_names_stay(tmp_path):
    assert inside(tmp_path, "frames/0001.dng", file=tmp_path, field="f") == tmp_path / "frames" / "0001.dng"
