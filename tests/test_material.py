"""The material and its file."""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import phoslab
from phoslab import presets
from phoslab.bands import Bands
from phoslab.errors import PhoslabError
from phoslab.material import Material
from phoslab.presets import make_presets

numbers = st.floats(0, 1e300)


@st.composite
def materials(draw):
    n_c, n_b = draw(st.integers(1, 4)), draw(st.integers(1, 5))
    table = st.lists(st.lists(numbers, min_size=n_b, max_size=n_b), min_size=n_c, max_size=n_c)
    nullable = st.lists(
        st.lists(numbers | st.just(np.nan), min_size=n_b, max_size=n_b), min_size=n_c, max_size=n_c
    )
    edges = draw(st.lists(st.floats(100, 2000), min_size=n_b + 1, max_size=n_b + 1, unique=True))
    return Material(
        name=draw(st.text(min_size=1, max_size=20).filter(str.isprintable)),
        bands=Bands(np.sort(edges)),
        kr_per_s=np.array(draw(st.lists(numbers, min_size=n_c, max_size=n_c))),
        ke_m2_per_J=np.array(draw(nullable)),
        emission=np.array(draw(table)),
        calibration=draw(st.sampled_from(["relative", "absolute"])),
        ke_upper_limit=np.array(draw(nullable)),
        reference_irradiance=np.array(draw(table))[0],
        valid_s=(0.0, draw(st.floats(1e-9, 1e9))),
    )


@given(materials())
def test_a_file_gives_back_the_same_numbers_to_the_last_bit(material):
    back = Material.from_json(material.to_json())
    for name in ("kr_per_s", "ke_m2_per_J", "emission", "ke_upper_limit", "reference_irradiance"):
        assert getattr(back, name).tobytes() == getattr(material, name).tobytes()
    assert back.bands == material.bands
    assert (back.name, back.valid_s, back.calibration) == (
        material.name,
        material.valid_s,
        material.calibration,
    )


def green(**changed) -> dict:
    return json.loads(phoslab.preset("green").to_json()) | changed


@pytest.mark.parametrize(
    ("changed", "named"),
    [
        ({"kr_per_s": [-0.1]}, r"kr_per_s\[0\]"),
        ({"kr_per_s": ["fast"]}, r"kr_per_s\[0\]"),
        ({"kr_per_s": []}, "kr_per_s"),
        ({"kr_per_s": [0.1] * 5}, "kr_per_s"),
        ({"kr_per_s": [True]}, r"kr_per_s\[0\]"),
        ({"kr_per_s": [0.1, 0.2]}, "ke_m2_per_J"),
        ({"ke_m2_per_J": [[0.1] * 7]}, "ke_m2_per_J"),
        ({"ke_m2_per_J": [[0.1] * 7 + [-1]]}, r"ke_m2_per_J\[0\]\[7\]"),
        ({"emission": [[1.0] * 7 + [None]]}, r"emission\[0\]\[7\]"),
        ({"emission": [[1.0] * 8, [1.0]]}, "emission has rows of unlike length"),
        ({"band_edges_nm": [400, 500, 450]}, "band_edges_nm"),
        ({"band_edges_nm": [400, 500]}, "ke_m2_per_J"),
        ({"calibration": "guessed"}, "calibration"),
        ({"schema": "phoslab-material/2"}, "schema"),
        ({"albedo": [1.5] * 8}, r"albedo\[0\]"),
        ({"valid_s": [10, 5]}, "valid_s"),
        ({"maps": {"colour": "x.exr"}}, "maps"),
        ({"colour": "green"}, "colour"),
        ({"name": ""}, "name"),
        ({"name": "a\u001b[2J"}, "name holds control characters"),
    ],
)
def test_a_malformed_file_is_refused_and_the_field_named(tmp_path, changed, named):
    file = tmp_path / "m.json"
    file.write_text(json.dumps(green(**changed)))
    with pytest.raises(PhoslabError, match=named) as caught:
        Material.load(file)
    assert str(file) in str(caught.value)
    assert caught.value.remedy


@pytest.mark.parametrize(
    "missing", ["schema", "name", "band_edges_nm", "kr_per_s", "emission", "calibration"]
)
def test_a_missing_field_is_named(missing):
    data = green()
    del data[missing]
    with pytest.raises(PhoslabError, match=missing):
        Material.from_json(json.dumps(data))


@pytest.mark.parametrize(
    "text", ["", "{", "[]", "null", '{"a": NaN}', '{"a": 1e999}', '{"a": 1, "a": 2}', "[" * 10**5]
)
def test_what_is_not_strict_json_is_refused(text):
    with pytest.raises(PhoslabError):
        Material.from_json(text)


def test_optional_fields_may_be_absent():
    required = ("schema", "name", "band_edges_nm", "kr_per_s", "ke_m2_per_J", "emission", "calibration")
    material = Material.from_json(json.dumps({k: v for k, v in green().items() if k in required}))
    assert material.albedo is None
    assert material.valid_s is None


def test_a_material_cannot_be_changed():
    material = phoslab.preset("green")
    with pytest.raises(AttributeError):
        material.name = "red"
    with pytest.raises(ValueError, match="read-only"):
        material.kr_per_s[0] = 1.0


def test_an_absolute_material_that_gives_more_than_it_takes_is_reported():
    m = Material(
        name="perpetual",
        bands=Bands(np.array([400.0, 500.0])),
        kr_per_s=np.array([1.0]),
        ke_m2_per_J=np.array([[1.0]]),
        emission=np.array([[0.01]]),  # gives pi * 0.01 * 100 nm * 1.0 = pi for each unit taken
        calibration="absolute",
        albedo=np.array([0.25]),
    )
    assert m.excess_emission() == pytest.approx([np.pi - 0.75])


def test_saving_leaves_the_old_file_if_it_fails(tmp_path, monkeypatch):
    file = tmp_path / "m.json"
    phoslab.preset("green").save(file)
    before = file.read_text()
    monkeypatch.setattr("os.fsync", lambda _: (_ for _ in ()).throw(OSError(28, "No space left on device")))
    with pytest.raises(PhoslabError, match="No space left"):
        phoslab.preset("red").save(file)
    assert file.read_text() == before
    assert [p.name for p in tmp_path.iterdir()] == ["m.json"]


def test_preset_files_are_what_the_published_tables_say():
    made = {name: m.to_json() for name, m in make_presets.presets()}
    assert sorted(made) == presets.names()
    for name, text in made.items():
        shipped = presets.preset(name)
        fresh = Material.from_json(text)
        # The lamp is computed: another version of colour-science may differ in the last bits.
        assert shipped.reference_irradiance == pytest.approx(fresh.reference_irradiance, rel=1e-12)
        assert shipped.emission.tobytes() == fresh.emission.tobytes()
        assert shipped.ke_m2_per_J.tobytes() == fresh.ke_m2_per_J.tobytes()
        assert shipped.kr_per_s.tobytes() == fresh.kr_per_s.tobytes()


def test_the_reference_lamp_charges_the_paints_to_the_saturation_that_the_paper_observed():
    from phoslab.kinetics import equilibrium

    paints = [m for m in map(presets.preset, presets.names()) if not np.isnan(m.ke_m2_per_J).any()]
    charged = [equilibrium(m, m.reference_irradiance)[0] for m in paints]
    assert len(paints) == 8
    assert [round(min(charged), 2), round(max(charged), 2)] == [0.69, 0.91]


def test_an_unknown_preset_names_the_known_ones():
    with pytest.raises(PhoslabError, match=r"'grün'.*green"):
        presets.preset("grün")
