#version 430
// Added up by blending: how many triangles cover a texel of the atlas.
layout(location = 0) out float count;

void main() {
    count = 1.0;
}
