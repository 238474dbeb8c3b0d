#version 430
// How much of what the filter would add up at a pixel, if all around were one surface in one light, it does add up there.
layout(local_size_x = 8, local_size_y = 8) in;
#include "receivers.glsl"
#include "filter_weight.glsl"

layout(std430, binding = 2) writeonly buffer Shares { float shares[]; }; // 1 / RADIUS² .. 1; 0 where nothing is seen

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy), size = picture_size();
    if (any(greaterThanEqual(pixel, size))) return;
    vec3 p, n;
    bool there = find_receiver(pixel, p, n);
    vec2 total = vec2(0.0);
    for (int k = 1 - RADIUS; k < RADIUS; ++k)
        for (int axis = 0; axis < 2; ++axis)
            total[axis] += filter_weight(pixel, p, n, k * ivec2(1 - axis, axis), k, size);
    shares[pixel.y * size.x + pixel.x] = there ? total.x * total.y / float(RADIUS * RADIUS * RADIUS * RADIUS) : 0.0;
}
