#version 430
// What is seen at each sample of the picture.
in vec3 v_position_w;
in vec3 v_normal_w;
in vec4 v_uv;
uniform float handedness; // -1 where the node mirrors its mesh
uniform float drawable;
layout(location = 0) out vec4 position_w; // w: the drawable's number, from 1; 0 is background
layout(location = 1) out vec4 normal_w;
layout(location = 2) out vec4 uv; // xy: atlas, zw: texture

void main() {
    vec3 n = normalize(v_normal_w);
    position_w = vec4(v_position_w, drawable);
    // A surface is lit on the side that is seen: thin sheets are modelled by one layer of triangles.
    normal_w = vec4(gl_FrontFacing == (handedness > 0.0) ? n : -n, 0.0);
    uv = v_uv;
}
