#version 430
// Shares light among the pixels of a surface, along one axis: a tent of RADIUS pixels to each side, under which every
// place of the pattern of directions counts alike. Cross-bilateral, by position, normal and light, and not far where
// the surroundings are near.
layout(local_size_x = 8, local_size_y = 8) in;
#include "receivers.glsl"
#include "alike.glsl"
#include "same_light.glsl"

uniform sampler2DArray light_in;
uniform ivec2 along;
layout(std430, binding = 0) readonly buffer Nearness { float nearness[]; }; // sum of 1 / distance met, of the aimless directions
layout(std430, binding = 1) readonly buffer Guide { vec2 guide[]; };       // where shadows may end: light, and its variance
layout(rgba32f, binding = 0) writeonly uniform image2DArray light;

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy), size = imageSize(light).xy;
    if (any(greaterThanEqual(pixel, size))) return;
    vec3 p, n, q, m;
    bool there = find_receiver(pixel, p, n);
    vec4 sum[LAYERS];
    float total = 0.0;
    for (int l = 0; l < LAYERS; ++l) sum[l] = vec4(0.0);
    float surroundings = float(max(AIMLESS, 1)) / nearness[pixel.y * size.x + pixel.x];
    for (int k = 1 - RADIUS; there && k < RADIUS; ++k) {
        ivec2 at = pixel + k * along;
        if (any(lessThan(at, ivec2(0))) || any(greaterThanEqual(at, size)) || !find_receiver(at, q, m)) continue;
        float w = float(RADIUS - abs(k));
        if (k != 0) {
            w *= alike(p, n, q, m) * near_enough(p, q, surroundings);
            w *= same_light(guide[pixel.y * size.x + pixel.x], guide[at.y * size.x + at.x]);
        }
        if (w <= 0.0) continue;
        total += w;
        for (int l = 0; l < LAYERS; ++l) sum[l] += w * texelFetch(light_in, ivec3(at, l), 0);
    }
    for (int l = 0; l < LAYERS; ++l) imageStore(light, ivec3(pixel, l), sum[l] / max(total, 1e-6));
}
