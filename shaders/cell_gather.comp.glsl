#version 430
// The mean radiance that the rays of each point meet: E / π.
layout(local_size_x = 64) in;
#include "items.glsl"

layout(std430, binding = 0) readonly buffer Hits { uint hits[]; };     // DIRECTIONS a point: 1 + 2 leaf + back, or 0
layout(std430, binding = 1) readonly buffer Leaves { vec4 leaves[]; }; // LAYERS a side, front and back of each leaf
layout(std430, binding = 2) writeonly buffer Light { vec4 light[]; };  // LAYERS a point
uniform int point_count;

void main() {
    int at = int(item_number());
    if (at >= point_count) return;
    vec4 L[LAYERS];
    for (int l = 0; l < LAYERS; ++l) L[l] = vec4(0.0);
    for (int k = 0; k < DIRECTIONS; ++k) {
        uint hit = hits[at * DIRECTIONS + k];
        if (hit > 0u)
            for (int l = 0; l < LAYERS; ++l) L[l] += leaves[(hit - 1u) * LAYERS + l];
    }
    for (int l = 0; l < LAYERS; ++l) light[at * LAYERS + l] = L[l] / float(DIRECTIONS);
}
