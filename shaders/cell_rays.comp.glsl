#version 430
// The nearest of the smallest cells on each ray of some points: a walk down the tree, past what the ray cannot meet.
// The rays of a point crowd as the cosine; those of the next are the same, moved on within the unit square.
layout(local_size_x = 64) in;
#include "items.glsl"
#include "hemisphere.glsl"

struct Test {
    vec4 N, U, V; // distance from the plane, and shares of the sides, of a point
    vec4 more;    // error, the most of u + v
};
struct Point {
    vec4 position; // w: 0 where there is none
    vec4 normal;
};

layout(std430, binding = 0) readonly buffer Points { Point points[]; };
layout(std430, binding = 1) readonly buffer Spheres { vec4 spheres[]; };
layout(std430, binding = 2) readonly buffer Skip { uvec2 skip[]; }; // after the last descendant; first leaf
layout(std430, binding = 3) readonly buffer Tests { Test tests[]; };
layout(std430, binding = 4) readonly buffer Square { vec2 square[]; };   // DIRECTIONS points of the unit square
layout(std430, binding = 5) writeonly buffer Hits { uint hits[]; }; // DIRECTIONS a point: 1 + 2 leaf + back, or 0
uniform int point_count;
uniform int cell_count;

const float PARALLEL = 0.8;
const float PROTRUDING = 4.0;
const float COPLANAR = 2e-5;
const float EDGE = 1e-5;
const float LIKENESS = 2.0; // the corners of a likeness reach this much farther, squared, than what it stands for

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
        vec3 o = point.position.xyz, n = point.normal.xyz, x, y;
        find_basis(n, x, y);
        uint seed = hash(uint(at));
        vec2 moved = vec2(seed & 0xffffu, seed >> 16) / 65536.0;
        vec3 w = on_hemisphere(fract(square[k] + moved));
        vec3 d = w.x * x + w.y * y + w.z * n;
        float nearest = 1e30;
        for (uint c = 0u; c < uint(cell_count);) {
            vec4 sphere = spheres[c];
            vec3 to = sphere.xyz - o;
            float along = dot(to, d), reach = sphere.w * sphere.w * LIKENESS;
            if (dot(to, to) - along * along > reach || along < -2.0 * sphere.w || along - 2.0 * sphere.w > nearest) {
                c = skip[c].x;
                continue;
            }
            if (skip[c].x != c + 1u) {
                ++c;
                continue;
            }
            Test test = tests[c];
            uint leaf = skip[c].y;
            ++c;
            float h = dot(test.N.xyz, o) + test.N.w;
            if (abs(h) < test.more.x) {
                if (abs(dot(test.N.xyz, n)) > PARALLEL) continue;
                h = test.more.x;
            } else if (h < 0.0 && h > -PROTRUDING * (test.more.x - COPLANAR) && dot(test.N.xyz, n) > 0.0) {
                continue;
            }
            float t = -h / dot(test.N.xyz, d);
            vec3 p = o + t * d;
            float u = dot(test.U.xyz, p) + test.U.w, v = dot(test.V.xyz, p) + test.V.w;
            if (t > PROTRUDING * (test.more.x - COPLANAR) && t < nearest && min(u, v) >= -EDGE
                && max(u, v) <= 1.0 + EDGE && u + v <= test.more.y + EDGE) {
                nearest = t;
                hit = 1u + 2u * leaf + (h > 0.0 ? 0u : 1u);
            }
        }
    }
    hits[at * DIRECTIONS + k] = hit;
}
