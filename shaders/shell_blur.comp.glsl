#version 430
// Shares the light of the coarser levels among the pixels of a surface: 1 2 1, `stride` apart, along one axis. Strides
// of 2^(l-1), ... 2, 1 make a tent under which each pixel of a block of level l counts alike.
layout(local_size_x = 8, local_size_y = 8) in;
#include "receivers.glsl"
#include "alike.glsl"

uniform sampler2DArray light_in;
uniform ivec2 along; // times the stride
layout(rgba32f, binding = 0) writeonly uniform image2DArray light;

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy), size = imageSize(light).xy;
    if (any(greaterThanEqual(pixel, size))) return;
    vec3 p, n, q, m;
    bool there = find_receiver(pixel, p, n);
    vec4 sum[LAYERS];
    float total = 2.0;
    for (int l = 0; l < LAYERS; ++l) sum[l] = 2.0 * texelFetch(light_in, ivec3(pixel, l), 0);
    for (int k = -1; there && k <= 1; k += 2) {
        ivec2 at = pixel + k * along;
        if (any(lessThan(at, ivec2(0))) || any(greaterThanEqual(at, size)) || !find_receiver(at, q, m)) continue;
        float w = alike(p, n, q, m);
        total += w;
        for (int l = 0; l < LAYERS; ++l) sum[l] += w * texelFetch(light_in, ivec3(at, l), 0);
    }
    for (int l = 0; l < LAYERS; ++l) imageStore(light, ivec3(pixel, l), sum[l] / total);
}
