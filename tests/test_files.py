"""Whole-or-absent writing, and names that stay inside."""

import os
from pathlib import Path

import pytest

from phoslab.errors import PhoslabError
from phoslab.files import inside, read_regular, replacing, write_text


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


def test_a_device_a_link_or_a_folder_is_never_replaced(tmp_path):
    (tmp_path / "real").write_text("keep")
    (tmp_path / "link").symlink_to(tmp_path / "real")
    os.mkfifo(tmp_path / "pipe")
    for target in (tmp_path / "link", tmp_path / "pipe", tmp_path, Path("/dev/null")):
        with pytest.raises(PhoslabError, match="Name a file to write"):
            write_text(target, "x")
    assert (tmp_path / "real").read_text() == "keep"


def test_a_refused_output_makes_no_folders(tmp_path):
    with pytest.raises(PhoslabError):
        write_text(tmp_path / "new" / ".." / "real" / ("n" * 300), "x")
    assert list(tmp_path.iterdir()) == []


def test_a_pipe_a_device_and_a_huge_file_are_not_read(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "large").write_bytes(b"x" * 11)
    for path in (tmp_path / "pipe", Path("/dev/zero"), tmp_path / "large", tmp_path / "absent", tmp_path):
        with pytest.raises(PhoslabError, match="Do this"):
            read_regular(path, 10, remedy="Do this.")
    assert read_regular(tmp_path / "large", 11, remedy="") == b"x" * 11
