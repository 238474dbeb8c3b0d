#version 430
// Shares light among the pixels of a surface, along one axis: a tent of RADIUS pixels to each side, under which every
// place of the pattern of directions counts alike.
layout(local_size_x = 8, local_size_y = 8) in;
#include "receivers.glsl"
#include "filter_weight.glsl"

uniform sampler2DArray light_in;
uniform ivec2 along;
layout(rgba32f, binding = 0) writeonly uniform image2DArray light;

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy), size = imageSize(light).xy;
    if (any(greaterThanEqual(pixel, size))) return;
    vec3 p, n;
    bool there = find_receiver(pixel, p, n);
    vec4 sum[LAYERS];
    float total = 0.0;
    for (int l = 0; l < LAYERS; ++l) sum[l] = vec4(0.0);
    for (int k = 1 - RADIUS; there && k < RADIUS; ++k) {
        float w = filter_weight(pixel, p, n, k * along, k, size);
        if (w <= 0.0) continue;
        total += w;
        for (int l = 0; l < LAYERS; ++l) sum[l] += w * texelFetch(light_in, ivec3(pixel + k * along, l), 0);
    }
    for (int l = 0; l < LAYERS; ++l) imageStore(light, ivec3(pixel, l), sum[l] / max(total, 1e-6));
}
