#version 430
// The least and greatest coordinates of what blocks of pixels see: a min/max MIP map, for the culling of splats.
// BASE: of blocks of 4 x 4 pixels; else of 2 x 2 blocks of the level below.
layout(local_size_x = 8, local_size_y = 8) in;
#include "receivers.glsl"

layout(std430, binding = 0) buffer Boxes { vec4 boxes[]; }; // low and high of each block, level after level
uniform ivec2 size;       // of this level in blocks
uniform int first;        // box of this level
uniform ivec2 size_below;
uniform int first_below;

void main() {
    ivec2 block = ivec2(gl_GlobalInvocationID.xy);
    if (any(greaterThanEqual(block, size))) return;
    vec3 low = vec3(1e30), high = vec3(-1e30);
#ifdef BASE
    for (int k = 0; k < 16; ++k) {
        ivec2 pixel = 4 * block + ivec2(k % 4, k / 4);
        vec3 p, n;
        if (any(greaterThanEqual(pixel, picture_size())) || !find_receiver(pixel, p, n)) continue;
        low = min(low, p);
        high = max(high, p);
    }
#else
    for (int k = 0; k < 4; ++k) {
        ivec2 below = 2 * block + ivec2(k % 2, k / 2);
        if (any(greaterThanEqual(below, size_below))) continue;
        int at = 2 * (first_below + below.y * size_below.x + below.x);
        low = min(low, boxes[at].xyz);
        high = max(high, boxes[at + 1].xyz);
    }
#endif
    int at = 2 * (first + block.y * size.x + block.x);
    boxes[at] = vec4(low, 0.0);
    boxes[at + 1] = vec4(high, 0.0);
}
