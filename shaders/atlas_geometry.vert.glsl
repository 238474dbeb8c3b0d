#version 430
in vec3 position;
in vec3 normal;
in vec2 uv;
in vec2 atlas_uv;
uniform mat4 model_to_world;
uniform mat3 normal_to_world;
out vec3 v_position_w;
out vec3 v_normal_w;
out vec2 v_uv;

void main() {
    v_position_w = (model_to_world * vec4(position, 1.0)).xyz;
    v_normal_w = normal_to_world * normal;
    v_uv = uv;
    gl_Position = vec4(atlas_uv * 2.0 - 1.0, 0.0, 1.0);
}
