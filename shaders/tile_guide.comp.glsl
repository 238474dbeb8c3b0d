#version 430
// What a pixel would receive if all sent what it is taken to, and the variance of that mean: it knows where a shadow may
// end, and since it does not change while it is dark, the filter that it guides stays linear in the light.
layout(local_size_x = 64) in;
#include "items.glsl"
#include "cells.glsl"

layout(std430, binding = 1) readonly buffer Hits { uvec2 hits[]; }; // DIRECTIONS a pixel: 1 + 2 cell + back, or 0; weight
layout(std430, binding = 2) readonly buffer Pixels { uint pixels[]; };
layout(std430, binding = 3) writeonly buffer Guide { vec2 guide[]; };
layout(std430, binding = 4) readonly buffer Corners { vec4 corners[]; }; // three a cell; w of the second: what it sends
uniform int count; // of the pixels

void main() {
    int item = int(item_number());
    if (item >= count) return;
    float sum = 0.0, squares = 0.0;
    for (int k = 0; k < DIRECTIONS; ++k) {
        uvec2 hit = hits[item * DIRECTIONS + k];
        if ((hit.x & 1u) == 0u) continue;
        uint cell = hit.x / 2u;
        float light = uintBitsToFloat(hit.y) * float(glows(cell)) * corners[3u * cell + 1u].w;
        sum += light;
        squares += light * light;
    }
    float mean = sum / float(DIRECTIONS);
    // One direction tells nothing of its noise: as large as the mean.
    float variance = max(squares / float(DIRECTIONS) - mean * mean, 0.0) / max(float(DIRECTIONS) - 1.0, 1.0);
    guide[pixels[item]] = vec2(mean, DIRECTIONS > 1 ? variance : mean * mean);
}
