#version 430
// The nearest of the smallest cells on each ray of some points.
// The rays of a point crowd as the cosine; those of the next are the same, moved on within the unit square.
layout(local_size_x = 64) in;
#include "items.glsl"
#include "hemisphere.glsl"
#include "cell_walk.glsl"

struct Point {
    vec4 position; // w: 0 where there is none
    vec4 normal;
};

layout(std430, binding = 1) readonly buffer Points { Point points[]; };
layout(std430, binding = 2) readonly buffer Leaves { uint leaf_of[]; };
layout(std430, binding = 3) readonly buffer Square { vec2 square[]; }; // DIRECTIONS points of the unit square
layout(std430, binding = 4) writeonly buffer Hits { uint hits[]; };    // DIRECTIONS a point: 1 + 2 leaf + back, or 0
uniform int point_count;

const vec4 EVERYWHERE = vec4(0.0, 0.0, 0.0, 1e6); // nothing is far: of likenesses, the smallest are met

uint hash(uint x) { // Wellons's lowbias32
    x = (x ^ (x >> 16)) * 0x7feb352du;
    x = (x ^ (x >> 15)) * 0x846ca68bu;
    return x ^ (x >> 16);
}

void main() {
    uint item = item_number();
    int k = int(item % uint(DIRECTIONS)), at = int(item / uint(DIRECTIONS));
    if (at >= point_count) return;
    Point point = points[at];
    uint hit = 0u;
    if (point.position.w > 0.0) {
        vec3 x, y;
        find_basis(point.normal.xyz, x, y);
        uint seed = hash(uint(at));
        vec2 moved = vec2(seed & 0xffffu, seed >> 16) / 65536.0;
        vec3 w = on_hemisphere(fract(square[k] + moved));
        Ray ray;
        ray.o = point.position.xyz;
        ray.n = point.normal.xyz;
        turn(ray, w.x * x + w.y * y + w.z * ray.n);
        Met met = walk_of(ray, EVERYWHERE);
        Part part = part_of(met.cell);
        while (part.count > 1u) part = half_at(part, ray.o + met.away * ray.d);
        if (met.away < NOWHERE) hit = 1u + 2u * leaf_of[part.cell] + (met.slope < 0.0 ? 0u : 1u);
    }
    hits[at * DIRECTIONS + k] = hit;
}
