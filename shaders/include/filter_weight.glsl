// What a neighbour's light weighs in the filter: a tent, cross-bilateral, by position, normal and light, and not far where
// the surroundings are near.
#include "alike.glsl"
#include "same_light.glsl"

layout(std430, binding = 0) readonly buffer Nearness { float nearness[]; }; // sum of 1 / distance met, of the aimless directions
layout(std430, binding = 1) readonly buffer Guide { vec2 guide[]; };       // where shadows may end: light, and its variance

// Of the pixel `off` from `pixel`, k pixels away, which sees p where the surface faces n.
float filter_weight(ivec2 pixel, vec3 p, vec3 n, ivec2 off, int k, ivec2 size) {
    float tent = float(RADIUS - abs(k));
    if (k == 0) return tent;
    ivec2 at = pixel + off;
    vec3 q, m;
    if (any(lessThan(at, ivec2(0))) || any(greaterThanEqual(at, size)) || !find_receiver(at, q, m)) return 0.0;
    float surroundings = float(max(AIMLESS, 1)) / nearness[pixel.y * size.x + pixel.x];
    return tent * alike(p, n, q, m) * near_enough(p, q, surroundings)
        * same_light(guide[pixel.y * size.x + pixel.x], guide[at.y * size.x + at.x]);
}
