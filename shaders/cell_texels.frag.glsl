#version 430
// To which of the smallest cells a texel of the atlas belongs, and what area it stands for.
flat in vec2 v_value;
layout(location = 0) out vec2 value;

void main() {
    value = v_value;
}
