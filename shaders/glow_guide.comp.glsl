#version 430
// Smooths the light by which the filter tells shadows' edges from noise: the mean over the 3 x 3 pixels of a surface, and
// the variance of that mean. One pixel's few directions know neither well.
layout(local_size_x = 8, local_size_y = 8) in;
#include "receivers.glsl"
#include "alike.glsl"
#include "same_light.glsl"

uniform ivec2 size;
layout(std430, binding = 0) readonly buffer Guide { vec2 guide[]; };      // mean, its variance
layout(std430, binding = 1) writeonly buffer Smooth { vec2 smoothed[]; }; // the same

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    if (any(greaterThanEqual(pixel, size))) return;
    vec3 p, n, q, m;
    bool there = find_receiver(pixel, p, n);
    vec2 own = guide[pixel.y * size.x + pixel.x], sum = vec2(0.0);
    float total = 0.0;
    for (int y = -1; there && y <= 1; ++y)
        for (int x = -1; x <= 1; ++x) {
            ivec2 at = pixel + ivec2(x, y);
            if (any(lessThan(at, ivec2(0))) || any(greaterThanEqual(at, size)) || !find_receiver(at, q, m)) continue;
            vec2 neighbour = guide[at.y * size.x + at.x];
            float w = x == 0 && y == 0 ? 1.0 : alike(p, n, q, m) * same_light(own, neighbour);
            sum += vec2(w, w * w) * neighbour;
            total += w;
        }
    smoothed[pixel.y * size.x + pixel.x] = sum / vec2(max(total, 1e-6), max(total * total, 1e-6));
}
