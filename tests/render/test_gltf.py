"""glTF 2.0 as exporters write it: every accessor form, hierarchy, cameras, lights, textures."""

from __future__ import annotations

import numpy as np
import pytest

from phoslab.render.gltf import load_gltf

SQUARE = np.array([[-0.5, -0.5, 0], [0.5, -0.5, 0], [0.5, 0.5, 0], [-0.5, 0.5, 0]])


def read(build):
    return load_gltf(build.write().with_name("scene.gltf"))


@pytest.mark.parametrize(("dtype", "component"), [("u1", 5121), ("<u2", 5123), ("<u4", 5125)])
def test_indices_of_every_width_are_read(build, dtype, component):
    build.mesh("quad").camera()
    indices = build.accessor(np.array([[0], [1], [2], [0], [2], [3]], dtype=dtype), component, "SCALAR")
    build.gltf["meshes"][0]["primitives"][0]["indices"] = indices
    assert len(read(build).instances[0].geometry.triangles) == 2


def test_interleaved_accessors_are_read_by_their_stride(build):
    build.mesh("quad").camera()
    rows = np.zeros(4, dtype=[("p", "<f4", 3), ("uv", "<f4", 2)])
    rows["p"], rows["uv"] = SQUARE + 7, SQUARE[:, :2]
    first = build.accessor(rows.view("u1").reshape(4, -1), 5126, "VEC3", count=4)
    build.gltf["bufferViews"][-1]["byteStride"] = rows.itemsize
    view = build.gltf["accessors"][first]["bufferView"]
    build.gltf["accessors"].append(
        {"bufferView": view, "byteOffset": 12, "componentType": 5126, "count": 4, "type": "VEC2"}
    )
    attributes = build.gltf["meshes"][0]["primitives"][0]["attributes"]
    attributes["POSITION"], attributes["TEXCOORD_0"] = first, first + 1
    geometry = read(build).instances[0].geometry
    assert sorted(map(tuple, np.unique(geometry.positions, axis=0) - 7)) == sorted(map(tuple, SQUARE))
    np.testing.assert_array_equal(geometry.positions[:, :2] - 7, geometry.uv)


def test_sparse_accessors_replace_what_they_name(build):
    build.mesh("quad").camera()
    at = build.accessor(np.array([[2]], dtype="u1"), 5121, "SCALAR")
    to = build.accessor(np.array([[3.0, 4.0, 5.0]], dtype="<f4"), 5126, "VEC3")
    accessors = build.gltf["accessors"]
    position = build.gltf["meshes"][0]["primitives"][0]["attributes"]["POSITION"]
    accessors[position]["sparse"] = {
        "count": 1,
        "indices": {"bufferView": accessors[at]["bufferView"], "componentType": 5121},
        "values": {"bufferView": accessors[to]["bufferView"]},
    }
    assert (read(build).instances[0].geometry.positions == [3.0, 4.0, 5.0]).all(axis=1).any()


def test_normalised_integers_become_fractions(build):
    build.mesh("quad").camera()
    uv = np.array([[0, 0], [65535, 0], [65535, 65535], [0, 65535]], dtype="<u2")
    attributes = build.gltf["meshes"][0]["primitives"][0]["attributes"]
    attributes["TEXCOORD_0"] = build.accessor(uv, 5123, "VEC2", normalized=True)
    assert read(build).instances[0].geometry.uv.max() == 1.0


@pytest.mark.parametrize(("mode", "order"), [(5, [0, 1, 3, 2]), (6, [0, 1, 2, 3])])
def test_strips_and_fans_become_triangles_that_face_the_same_way(build, mode, order):
    build.mesh("quad").camera()
    primitive = build.gltf["meshes"][0]["primitives"][0]
    primitive["mode"] = mode
    primitive["indices"] = build.accessor(np.array(order, dtype="u1").reshape(-1, 1), 5121, "SCALAR")
    geometry = read(build).instances[0].geometry
    assert len(geometry.triangles) == 2
    np.testing.assert_allclose(geometry.normals, np.broadcast_to([0, 0, 1], geometry.normals.shape))


def test_points_are_refused(build, refuses):
    build.mesh("quad").camera()
    build.gltf["meshes"][0]["primitives"][0]["mode"] = 0
    assert "points or lines" in refuses(read, build)


def test_nodes_inherit_from_their_parents(build):
    """Translation after rotation after scale, parents applied last."""
    build.mesh("quad", scale=[2, 2, 2], translation=[1, 0, 0]).camera()
    half = np.sqrt(0.5)
    build.gltf["nodes"].append({"children": [0], "rotation": [0, 0, half, half], "translation": [0, 0, 5]})
    build.gltf["scenes"][0]["nodes"] = [1, 2]
    matrix = read(build).instances[0].model_to_world
    np.testing.assert_allclose(matrix @ [0.5, 0, 0, 1], [0, 2, 5, 1], atol=1e-12)


def test_a_cycle_of_nodes_is_refused(build, refuses):
    build.mesh("quad").camera()
    build.gltf["nodes"][0]["children"] = [0]
    assert "not a tree" in refuses(read, build)


def test_camera_and_light_look_along_minus_z(build):
    matrix = np.eye(4)
    matrix[:3, 3] = [1, 2, 3]
    build.mesh("quad").camera(distance=4.0).light("sun", "directional", matrix)
    model = read(build)
    np.testing.assert_allclose(model.cameras[0].world_to_view @ [0, 0, 0, 1], [0, 0, -4, 1])
    np.testing.assert_allclose(model.lights[0].direction_w, [0, 0, -1])
    np.testing.assert_allclose(model.lights[0].position_w, [1, 2, 3])


def test_base_colour_textures_are_decoded_to_linear_with_their_first_row_at_v_0(build, tmp_path):
    from PIL import Image

    pixels = np.array([[[255, 0, 0], [188, 188, 188]], [[0, 0, 0], [0, 255, 0]]], dtype=np.uint8)
    Image.fromarray(pixels).save(tmp_path / "with space.png")
    build.mesh("quad", colour=(0.5, 1.0, 1.0)).camera()
    build.gltf["images"], build.gltf["textures"] = [{"uri": "with%20space.png"}], [{"source": 0}]
    build.gltf["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"] = {"index": 0}
    colour = read(build).instances[0].base_colour
    np.testing.assert_allclose(colour[0, 0], [0.5, 0, 0])
    # sRGB 188 is 50.3 % linear.
    np.testing.assert_allclose(colour[0, 1], [0.2515, 0.503, 0.503], atol=1e-3)


def test_missing_normals_are_the_triangles_own(build):
    geometry = read(build.mesh("quad").camera()).instances[0].geometry
    np.testing.assert_allclose(geometry.normals, np.broadcast_to([0, 0, 1], geometry.normals.shape))


def test_a_required_extension_that_is_unknown_is_refused(build, refuses):
    build.mesh("quad").camera()
    build.gltf["extensionsRequired"] = ["KHR_draco_mesh_compression"]
    assert "'KHR_draco_mesh_compression'" in refuses(read, build)


def test_skins_are_said_to_be_left_aside(build):
    build.mesh("quad").camera()
    build.gltf["skins"] = [{"joints": [0]}]
    assert "skins" in read(build).warnings[0]
