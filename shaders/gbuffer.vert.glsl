#version 430
in vec3 position;
in vec3 normal;
in vec2 uv;
in vec2 atlas_uv;
uniform mat4 model_to_world;
uniform mat3 normal_to_world;
uniform mat4 world_to_clip;
out vec3 v_position_w;
out vec3 v_normal_w;
out vec4 v_uv;

void main() {
    vec4 p_w = model_to_world * vec4(position, 1.0);
    v_position_w = p_w.xyz;
    v_normal_w = normal_to_world * normal;
    v_uv = vec4(atlas_uv, uv);
    gl_Position = world_to_clip * p_w;
}
