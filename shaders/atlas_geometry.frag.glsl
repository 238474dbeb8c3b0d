#version 430
// What lies under each texel of the atlas.
in vec3 v_position_w;
in vec3 v_normal_w;
in vec2 v_uv;
layout(location = 0) out vec4 position_w; // w: 1 where the mesh covers the texel
layout(location = 1) out vec4 normal_w;
layout(location = 2) out vec4 texture_uv;

void main() {
    position_w = vec4(v_position_w, 1.0);
    normal_w = vec4(normalize(v_normal_w), 0.0);
    texture_uv = vec4(v_uv, 0.0, 0.0);
}
