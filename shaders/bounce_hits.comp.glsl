#version 430
// Brings what one level found back to the pixels, where no finer level had found anything.
layout(local_size_x = 8, local_size_y = 8) in;
#include "interleaved.glsl"
#include "bounces.glsl"

layout(std430, binding = 2) readonly buffer Depths { uint depths[]; };
layout(std430, binding = 6) buffer Hits { uint hits[]; };
uniform ivec2 size; // of the picture
uniform int row;
uniform int surfel_bits;

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    if (any(greaterThanEqual(pixel, size))) return;
    ivec2 at = to_shuffled(pixel, count_blocks(size));
    for (int k = 0; k < DIRECTIONS; ++k) {
        uint depth = depths[(at.y * row + at.x) * DIRECTIONS + k];
        if (depth == 0u || depth == 0xffffffffu) continue;
        uint surfel = depth & ((1u << surfel_bits) - 1u);
        hits[(pixel.y * size.x + pixel.x) * DIRECTIONS + k] = (surfel + 1u) | (uint(level) << LEVEL_BIT);
    }
}
