#version 430
// The nearest cell in each of a pixel's directions, of those that its group was given: a z-buffer in registers.
//
// The first AIMLESS directions crowd as the cosine; the others aim at points of cells that may send light. Both are one
// sample by the balance heuristic (Veach and Guibas 1995): a ray's density is known, since every cell that it pierces
// is met in the loop, and may have been what it was aimed at.
layout(local_size_x = 16, local_size_y = 16) in;
#include "receivers.glsl"
#include "tiles.glsl"
#include "hemisphere.glsl"

struct Test {
    vec4 N, U, V; // distance from the plane, and shares of the sides, of a point
    vec4 more;    // error, the most of u + v
};

layout(std430, binding = 0) readonly buffer Groups { Group groups[]; };
layout(std430, binding = 1) readonly buffer Tests { Test tests[]; };
layout(std430, binding = 2) readonly buffer Ends { uint ends[]; }; // where each group's list begins; one more
layout(std430, binding = 3) readonly buffer Lists { uint lists[]; };
layout(std430, binding = 4) readonly buffer Points { vec2 points[]; }; // of the unit square; DIRECTIONS a place
layout(std430, binding = 5) writeonly buffer Hits { uvec2 hits[]; }; // DIRECTIONS a pixel: 1 + 2 cell + back, or 0; weight
layout(std430, binding = 6) buffer Nearness { float nearness[]; }; // sum of 1 / distance met, of the aimless
layout(std430, binding = 7) readonly buffer Guides { vec2 guides[]; }; // beside lists: per area, and summed
layout(std430, binding = 8) readonly buffer Walk { Cell cells[]; };
layout(std430, binding = 9) readonly buffer Skip { uint skip[]; };

uniform ivec2 tiles;
uniform int first; // of the BATCH directions of this run: more at once would leave the registers

const float PARALLEL = 0.8;
const float PROTRUDING = 4.0; // errors of a likeness within which it may be the receiver's own surface
const float INV_PI = 0.318309886;
const float SHARE = float(AIMLESS) / float(DIRECTIONS);
const float EDGE = 1e-5; // neighbouring cells overlap by this share, so that no ray slips between

// The direction from o to a point of one of the list's cells, chosen by what they promise.
vec3 aim(vec3 o, vec2 u, uint begin, uint end, float total) {
    float wanted = u.x * total;
    uint low = begin, high = end - 1u;
    while (low < high) {
        uint middle = (low + high) / 2u;
        if (guides[middle].y > wanted) high = middle; else low = middle + 1u;
    }
    float before = low > begin ? guides[low - 1u].y : 0.0;
    float s = clamp((wanted - before) / max(guides[low].y - before, 1e-30), 0.0, 1.0), t = u.y;
    Cell cell = cells[lists[low]];
    if (cell.more.y > 0.0) { // a triangle: the square, its far corner folded over
        float root = sqrt(s);
        s = root * (1.0 - t);
        t = root * t;
    }
    return normalize(cell.a.xyz + s * (cell.b.xyz - cell.a.xyz) + t * (cell.c.xyz - cell.a.xyz) - o);
}

// The smallest part of a flat cell that holds p: a cell is followed by its two halves.
uint find_part(uint cell, vec3 p) {
    while (skip[cell] > cell + 1u && cells[cell].more.x < COPLANAR) {
        Test half_ = tests[cell + 1u];
        float u = dot(half_.U.xyz, p) + half_.U.w, v = dot(half_.V.xyz, p) + half_.V.w;
        bool inside = min(u, v) >= 0.0 && max(u, v) <= 1.0 && u + v <= half_.more.y;
        cell = inside ? cell + 1u : skip[cell + 1u];
    }
    return cell;
}

void main() {
    // A tile's two groups follow each other: of llvmpipe's threads each takes one stretch of all, and second groups are few.
    ivec2 tile = ivec2(gl_WorkGroupID.x / 2u, gl_WorkGroupID.y);
    bool is_second = gl_WorkGroupID.x % 2u == 1u;
    int at = 2 * (tile.y * tiles.x + tile.x) + int(is_second);
    Group group = groups[at];
    if (group.count == 0.0) return;
    ivec2 pixel = TILE * tile + ivec2(gl_LocalInvocationID.xy), size = picture_size();
    vec3 o, n;
    if (any(greaterThanEqual(pixel, size)) || !find_receiver(pixel, o, n)) return;
    if (group.axis >= 0.0 && (o[int(group.axis)] > group.divide) != is_second) return;

    uint begin = ends[at], end = ends[at + 1];
    float total = end > begin ? guides[end - 1u].y : 0.0;
    float share = total > 0.0 ? SHARE : 1.0; // of the directions that are aimless
    vec3 x, y, d[BATCH];
    find_basis(n, x, y);
    int place = (pixel.y % PATTERN) * PATTERN + pixel.x % PATTERN;
    float nearest[BATCH], density[BATCH]; // over total
    uint hit[BATCH];
    for (int k = 0; k < BATCH; ++k) {
        vec2 u = points[place * DIRECTIONS + min(first + k, DIRECTIONS - 1)];
        if (first + k < AIMLESS || total <= 0.0) {
            vec3 w = on_hemisphere(u);
            d[k] = w.x * x + w.y * y + w.z * n;
        } else {
            d[k] = aim(o, u, begin, end, total);
        }
        nearest[k] = 1e30;
        density[k] = 0.0;
        hit[k] = 0u;
    }
    for (uint m = begin; m < end; ++m) {
        uint cell = lists[m];
        Test test = tests[cell];
        float h = dot(test.N.xyz, o) + test.N.w;
        if (abs(h) < test.more.x) {
            // In the cell's plane, or in the surface that it stands for. Where that is another surface than the
            // receiver's, which meets it in an edge, the receiver is in front.
            if (abs(dot(test.N.xyz, n)) > PARALLEL) continue;
            h = test.more.x;
        } else if (h < 0.0 && h > -PROTRUDING * (test.more.x - COPLANAR) && dot(test.N.xyz, n) > 0.0) {
            // A likeness of a curved surface protrudes from it, here over a part of the same surface.
            continue;
        }
        float u0 = dot(test.U.xyz, o) + test.U.w, v0 = dot(test.V.xyz, o) + test.V.w;
        uint seen = 1u + 2u * cell + (h > 0.0 ? 0u : 1u);
        float hope = guides[m].x, shortest = PROTRUDING * (test.more.x - COPLANAR);
        for (int k = 0; k < BATCH; ++k) {
            float inverse = 1.0 / dot(test.N.xyz, d[k]), t = -h * inverse;
            float u = u0 + t * dot(test.U.xyz, d[k]), v = v0 + t * dot(test.V.xyz, d[k]);
            if (t > shortest && min(u, v) >= -EDGE && max(u, v) <= 1.0 + EDGE && u + v <= test.more.y + EDGE) {
                density[k] += hope * t * t * abs(inverse);
                if (t < nearest[k]) {
                    nearest[k] = t;
                    hit[k] = seen;
                }
            }
        }
    }
    int at_pixel = pixel.y * size.x + pixel.x;
    float near = first == 0 ? 1e-30 : nearness[at_pixel];
    for (int k = 0; k < BATCH && first + k < DIRECTIONS; ++k) {
        float cosine = max(dot(d[k], n), 0.0) * INV_PI;
        float mixed = share * cosine + (1.0 - share) * density[k] / max(total, 1e-30);
        float weight = mixed > 0.0 ? cosine / mixed : 0.0;
        uint met = weight > 0.0 ? hit[k] : 0u;
        if (met > 0u) {
            uint cell = (met - 1u) / 2u;
            if (cells[cell].more.w > 0.0) met += 2u * (find_part(cell, o + nearest[k] * d[k]) - cell);
        }
        hits[at_pixel * DIRECTIONS + first + k] = uvec2(met, floatBitsToUint(weight));
        if (first + k < max(AIMLESS, 1)) near += 1.0 / nearest[k];
    }
    nearness[at_pixel] = near;
}
