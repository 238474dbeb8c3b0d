#version 430
// Triangles to surfels, in four steps with prefix sums between: what each item makes is counted, so that every item of
// the next step finds its place and its origin, in the same order every time.
//
// PARTS   triangle -> number of its parts: large ones are halved where surfels' ideal size changes over them
// POINTS  part     -> number of its fine surfels
// SHARES  point    -> the share of an ideal surfel that it stands for, at most 1
// SURFELS point    -> a surfel of the ideal size, wherever the sum of the shares passes a whole number
layout(local_size_x = 64) in;
#include "items.glsl"
#include "surfelization.glsl"

layout(std430, binding = 0) readonly buffer Triangles { Triangle triangles[]; };
layout(std430, binding = 1) readonly buffer PartSums { uvec2 part_sums[]; };   // of each triangle, and of all
layout(std430, binding = 2) readonly buffer PointSums { uvec2 point_sums[]; }; // of each part, and of all
layout(std430, binding = 3) buffer Out { uvec2 sums[]; }; // 64 bits, low word first; SURFELS: of each point, and of all
layout(std430, binding = 4) writeonly buffer Surfels { Surfel surfels[]; };
uniform uint count;    // of the items
uniform uint triangle_count;
uniform uint part_count;

const uint HALF = ONE / 2u; // where the sum begins: a mesh of half a surfel becomes one

// The last entry whose sum is not above `item`: what it came from. Empty ones share their sum with the next.
#define FIND(sums, n) \
    uint low = 0u, high = n; \
    while (high - low > 1u) { \
        uint middle = (low + high) / 2u; \
        if (sums[middle].x <= item) low = middle; else high = middle; \
    }

void find_part(uint item, out uint triangle, out mat3 corners, out float area) {
    FIND(part_sums, triangle_count)
    triangle = low;
    Triangle t = triangles[low];
    int n = halvings(t);
    corners = part_of(item - part_sums[low].x, n);
    area = t.b.w / float(1 << (2 * n));
}

uint find_point(uint item, out uint k) {
    FIND(point_sums, part_count)
    k = item - point_sums[low].x;
    return low;
}

void main() {
    uint item = item_number();
    if (item >= count) return;
#if STEP == PARTS
    sums[item] = uvec2(triangles[item].b.w > 0.0 ? 1u << (2 * halvings(triangles[item])) : 0u, 0u);
#else
    uint triangle, k = 0u;
    mat3 corners;
    float area;
#if STEP == POINTS
    find_part(item, triangle, corners, area);
    sums[item] = uvec2(count_surfels(triangles[triangle], corners, area), 0u);
#else
    uint part = find_point(item, k);
    find_part(part, triangle, corners, area);
    Triangle t = triangles[triangle];
    vec3 at = corners * point_on(part, k);
    vec3 p = mat3(t.a.xyz, t.b.xyz, t.c.xyz) * at;
    area /= float(point_sums[part + 1u].x - point_sums[part].x);
#ifdef ONE_PASS
    float ideal = area;
#else
    float ideal = ideal_area(t, distance(p, eye));
#endif
#if STEP == SHARES
    // Rounded at random to the next of 2^24 parts, so that the tiniest triangles count on the mean.
    float parts = min(area / ideal, 1.0) * float(ONE);
    float rest = float(hash(uvec3(item, 3u, 5u)).x) * 2.3283064e-10;
    sums[item] = uvec2(min(uint(parts + rest), ONE), 0u);
#else
    uint carry, carry_next;
    uvec2 begin = sums[item], end = sums[item + 1u];
    uint begin_low = uaddCarry(begin.x, HALF, carry), end_low = uaddCarry(end.x, HALF, carry_next);
    uint place = ((begin.y + carry) << 8) | (begin_low >> 24);
    if (place == (((end.y + carry_next) << 8) | (end_low >> 24))) return;
    vec2 uv = at.x * t.uv.xy + at.y * t.uv.zw + at.z * t.more.xy;
    vec3 n = normalize(cross(t.b.xyz - t.a.xyz, t.c.xyz - t.a.xyz)) * t.more.z;
    surfels[place].place = vec4(p, sqrt(ideal / PI));
    surfels[place].facing = vec4(n, t.a.w);
    surfels[place].texel = vec4(uv, 0.5 * log2(ideal) + t.c.w, 0.0);
#endif
#endif
#endif
}
