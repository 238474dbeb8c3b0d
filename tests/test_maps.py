"""Material maps."""

import os
from dataclasses import replace

import numpy as np
import pytest

import phoslab
from phoslab import maps
from phoslab.errors import PhoslabError

RNG = np.random.default_rng(5)


def with_map(tmp_path, values, field="emission", **options):
    maps.write_map(tmp_path / "map.exr", values, **options)
    return replace(phoslab.preset("stickers-2"), maps={field: "map.exr"}, folder=tmp_path)


@pytest.mark.parametrize(
    ("field", "shape"), [("kr_per_s", (2,)), ("emission", (2, 8)), ("ke_m2_per_J", (2, 8))]
)
def test_a_map_is_read_back_bit_for_bit(tmp_path, field, shape):
    values = RNG.uniform(size=(5, 7, *shape)).astype(np.float32)
    assert maps.load_maps(with_map(tmp_path, values, field))[field].tobytes() == values.tobytes()


def test_an_albedo_map_has_one_value_a_band(tmp_path):
    values = RNG.uniform(size=(3, 3, 8)).astype(np.float32)
    material = with_map(tmp_path, values, "albedo", by_band=True)
    assert maps.load_maps(material)["albedo"].tobytes() == values.tobytes()


def test_a_map_of_other_channels_is_refused(tmp_path):
    with pytest.raises(PhoslabError, match=r"channels.*s1\.b7"):
        maps.load_maps(with_map(tmp_path, np.ones((4, 4, 2), np.float32)))


def test_a_negative_or_non_finite_texel_is_refused(tmp_path):
    values = np.ones((4, 4, 2), np.float32)
    values[1, 1, 1] = np.nan
    with pytest.raises(PhoslabError, match="channel s1"):
        maps.load_maps(with_map(tmp_path, values, "kr_per_s"))


def test_a_map_that_is_no_exr_or_lies_elsewhere_is_refused(tmp_path):
    material = with_map(tmp_path, np.ones((2, 2, 2), np.float32), "kr_per_s")
    (tmp_path / "map.exr").write_bytes(b"not an image")
    with pytest.raises(PhoslabError, match=r"map\.exr.*OpenEXR"):
        maps.load_maps(material)
    with pytest.raises(PhoslabError, match="inside the folder"):
        maps.load_maps(replace(material, maps={"kr_per_s": "../map.exr"}))


def test_a_pipe_in_place_of_a_map_is_refused(tmp_path):
    material = with_map(tmp_path, np.ones((2, 2, 2), np.float32), "kr_per_s")
    (tmp_path / "map.exr").unlink()
    os.mkfifo(tmp_path / "map.exr")
    with pytest.raises(PhoslabError, match=r"map\.exr: is not a regular file"):
        maps.load_maps(material)
