#version 430
// Clears the bounced z-buffer of one level, and lays out the directions of its pixels as those lie in the sub-buffers.
layout(local_size_x = 8, local_size_y = 8) in;
#include "receivers.glsl"
#include "interleaved.glsl"

layout(std430, binding = 2) writeonly buffer Depths { uint depths[]; };         // DIRECTIONS a pixel
layout(std430, binding = 3) writeonly buffer Directions { uint directions[]; }; // DIRECTIONS a pixel
layout(std430, binding = 6) readonly buffer Hits { uint hits[]; };              // DIRECTIONS a pixel, in the picture's order
layout(std430, binding = 8) readonly buffer Looks { uvec2 looks[]; };           // the same: direction and weight
layout(rgba32f, binding = 0) uniform image2D shuffled_position;
uniform int row; // pixels of a row of sub-buffers

void main() {
    ivec2 at = ivec2(gl_GlobalInvocationID.xy), size = picture_size(), blocks = count_blocks(size);
    if (any(greaterThanEqual(at, blocks << level))) return;
    ivec2 pixel = to_pixel(at, blocks);
    vec3 p, n;
    bool there = all(lessThan(pixel, size)) && find_receiver(pixel, p, n);
    bool any_open = false;
    for (int k = 0; k < DIRECTIONS; ++k) {
        int word = (at.y * row + at.x) * DIRECTIONS + k;
        // What a finer level has found is nearer than all that this one may find.
        int look = (pixel.y * size.x + pixel.x) * DIRECTIONS + k;
        bool open = there && hits[look] == 0u && looks[look].y != 0u;
        any_open = any_open || open;
        depths[word] = open ? 0xffffffffu : 0u;
        directions[word] = open ? looks[look].x : 0u;
    }
    if (!any_open) imageStore(shuffled_position, at, vec4(0.0));
}
