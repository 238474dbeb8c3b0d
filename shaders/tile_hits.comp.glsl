#version 430
// What each of a pixel's directions meets first, by a walk down the tree of cells.
//
// The first AIMLESS directions crowd as the cosine; the others aim at points of cells that glow, and count where they meet
// the cell that they were aimed at. Both find the points that are seen from the pixel, and are one sample by the balance
// heuristic (Veach and Guibas 1995): either density follows from the point that was met.
//
// Every pattern of pixels has the same points, and all pixels of a tile aim by one list: a cell that one point too many
// aims at would be too bright in all patterns of a tile, and the picture a quilt. So each pattern has its points elsewhere
// in their strata: whatever pixels the filter brings together, they keep one point in each.
layout(local_size_x = 64) in;
#include "items.glsl"
#include "receivers.glsl"
#include "choice.glsl"
#include "cell_walk.glsl"
#include "hemisphere.glsl"

layout(std430, binding = 1) readonly buffer Groups { Group groups[]; };
layout(std430, binding = 2) readonly buffer Ends { uint ends[]; }; // where each group's list begins; one more
layout(std430, binding = 3) readonly buffer Aims { Aim aims[]; };
layout(std430, binding = 4) readonly buffer Corners { vec4 corners[]; }; // three a cell; w of the second: of each of its areas
layout(std430, binding = 5) readonly buffer Points { vec2 points[]; }; // of the unit square; DIRECTIONS a place
layout(std430, binding = 6) readonly buffer Pixels { uint pixels[]; }; // in rows; those of a tile follow each other
layout(std430, binding = 7) writeonly buffer Hits { uvec2 hits[]; }; // DIRECTIONS a pixel: 1 + 2 cell + back, or 0; weight
layout(std430, binding = 8) buffer Nearness { float nearness[]; }; // sum of 1 / distance met, of the aimless

uniform ivec2 tiles;
uniform int count; // of the pixels
uniform int first; // of the BATCH directions of this run
uniform bool all_send; // not only what glows
uniform bool is_first; // whether what is near is not known yet

const uint NONE = ~0u;
const float INV_PI = 0.318309886;
const float SHARE = float(AIMLESS) / float(DIRECTIONS);
// Of a plane of patterns, shifts that lie far apart: powers of the root of x^5 = x + 1 (Roberts 2018).
const mat2 SHIFTS = mat2(0.8566748838, 0.7338918566, 0.6287067210, 0.5385972572);

// The direction from o to a point of one of the list's cells, chosen by what they promise.
vec3 aim(vec3 o, vec2 u, uint begin, uint end, float total, out uint cell) {
    float wanted = u.x * total;
    uint low = begin, high = end - 1u;
    while (low < high) {
        uint middle = (low + high) / 2u;
        if (aims[middle].sum > wanted) high = middle; else low = middle + 1u;
    }
    float before = low > begin ? aims[low - 1u].sum : 0.0;
    float s = clamp((wanted - before) / max(aims[low].sum - before, 1e-30), 0.0, 1.0), t = u.y;
    cell = aims[low].cell;
    if (cells[cell].more.y < 1.5) { // a triangle: the square, its far corner folded over
        float root = sqrt(s);
        s = root * (1.0 - t);
        t = root * t;
    }
    vec3 a = corners[3u * cell].xyz, b = corners[3u * cell + 1u].xyz, c = corners[3u * cell + 2u].xyz;
    return normalize(a + s * (b - a) + t * (c - a) - o);
}

void main() {
    int item = int(item_number());
    if (item >= count) return;
    ivec2 size = picture_size();
    int at_pixel = int(pixels[item]);
    ivec2 pixel = ivec2(at_pixel % size.x, at_pixel / size.x), tile = pixel / TILE;
    Ray ray;
    if (!find_receiver(pixel, ray.o, ray.n)) return;
    int at = 2 * (tile.y * tiles.x + tile.x);
    Group group = groups[at];
    if (group.axis >= 0.0 && ray.o[int(group.axis)] > group.divide) group = groups[++at];

    uint begin = ends[at], end = ends[at + 1];
    float total = end > begin ? aims[end - 1u].sum : 0.0;
    float share = total > 0.0 ? SHARE : 1.0; // of the directions that are aimless
    vec3 x, y;
    find_basis(ray.n, x, y);
    int place = (pixel.y % PATTERN) * PATTERN + pixel.x % PATTERN;
    vec2 shift = SHIFTS * vec2(pixel / PATTERN);
    float near = first == 0 ? 1e-30 : nearness[at_pixel];
    for (int k = first; k < min(first + BATCH, DIRECTIONS); ++k) {
        float strata = float(k < AIMLESS ? AIMLESS_STRATA : AIMED_STRATA);
        vec2 stratum = points[place * DIRECTIONS + k] * strata;
        vec2 u = (floor(stratum) + fract(stratum + shift)) / strata;
        uint aimed = NONE;
        if (k < AIMLESS || total <= 0.0) {
            vec3 w = on_hemisphere(u);
            turn(ray, w.x * x + w.y * y + w.z * ray.n);
        } else {
            turn(ray, aim(ray.o, u, begin, end, total, aimed));
        }
        Met met = walk_of(ray, group.sphere);
        bool meets = met.away < NOWHERE, at_glow = meets && glows(met.cell);
        vec3 p = ray.o + met.away * ray.d;
        Part part = part_of(met.cell);
        while (at_glow && part.count > 1u && !is_aim(group, part.cell)) part = half_at(part, p);
        float sent = corners[3u * part.cell + 1u].w;
        float density = at_glow ? sent * promise(group, part.cell) * met.away * met.away / abs(met.slope) : 0.0;
        float facing = max(dot(ray.d, ray.n), 0.0) * INV_PI;
        float mixed = share * facing + (1.0 - share) * density / max(total, 1e-30);
        bool counts = meets && mixed > 0.0 && (aimed == NONE || aimed == part.cell);
        while ((at_glow || all_send) && part.count > 1u) part = half_at(part, p);
        uint hit = counts ? 1u + 2u * part.cell + (met.slope < 0.0 ? 0u : 1u) : 0u;
        hits[item * DIRECTIONS + k] = uvec2(hit, floatBitsToUint(counts ? facing / mixed : 0.0));
        if (k < max(AIMLESS, 1)) near += 1.0 / met.away;
    }
    if (is_first) nearness[at_pixel] = near;
}
