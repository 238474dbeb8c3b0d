#version 430
in vec2 uv;
in vec2 value;
flat out vec2 v_value;

void main() {
    v_value = value;
    gl_Position = vec4(uv * 2.0 - 1.0, 0.0, 1.0);
}
