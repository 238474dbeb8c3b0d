// What a ray meets first: a walk down the tree of cells, past those whose boxes it misses, and not below those that may
// stand for their parts.
//
// llvmpipe runs what an `if` guards whether it holds or not, for eight rays at once: so the walk is one short loop, and
// what the ray may meet is tested outside of it, by all together (Aila and Laine 2009). Nor is a loop guarded by an `if`
// within another: there it runs wrongly.
#include "cells.glsl"
#include "cell_boxes.glsl"

layout(std430, binding = 9) writeonly buffer Unfinished { uint unfinished; }; // whether a driver has ended a walk

struct Ray {
    vec3 o, n; // from o, where the surface faces n
    vec3 d;
    vec3 o_box, inverse; // among the boxes
};

const float PARALLEL = 0.8;
const float PROTRUDING = 4.0; // errors of a likeness within which it may be the receiver's own surface
const float EDGE = 1e-5; // neighbouring cells overlap by this share, so that no ray slips between

struct Met {
    uint cell;
    float away; // NOWHERE: nothing is met
    float slope; // the cosine of ray and normal; > 0 from the back
};
const float NOWHERE = 1e30;

void turn(inout Ray ray, vec3 d) {
    ray.d = d;
    ray.o_box = to_boxes(ray.o);
    ray.inverse = BOX_STEP / mix(d, vec3(1e-20), equal(d, vec3(0.0)));
}

// Whether a ray passes by a box, or ends before it.
bool is_missed(Box box, Ray ray, float nearest) {
    vec3 a = (box.low - ray.o_box) * ray.inverse, b = (box.high - ray.o_box) * ray.inverse, near = min(a, b), far = max(a, b);
    float enters = max(max(near.x, near.y), near.z), leaves = min(min(far.x, far.y), far.z);
    return enters > leaves || leaves < 0.0 || enters > nearest;
}

// Where a ray pierces a cell: how far away (< 0: nowhere), and over which cosine; > 0 from the back.
float find_hit(uint cell, Ray ray, out float cosine) {
    vec4 N = cells[cell].N, U = cells[cell].U, V = cells[cell].V;
    vec4 more = cells[cell].more;
    float error = more.x, in_plane = error + COPLANAR, h = dot(N.xyz, ray.o) + N.w;
    cosine = dot(N.xyz, ray.d);
    // In the cell's plane, or in the surface that it stands for. Where that is another surface than the receiver's, which
    // meets it in an edge, the receiver is in front.
    bool is_in = abs(h) < in_plane;
    // A likeness of a curved surface protrudes from it, here over a part of the same surface.
    bool protrudes = !is_in && h < 0.0 && h > -PROTRUDING * error && dot(N.xyz, ray.n) > 0.0;
    bool is_own = protrudes || (is_in && abs(dot(N.xyz, ray.n)) > PARALLEL);
    float t = -(is_in ? in_plane : h) / cosine;
    vec3 p = ray.o + t * ray.d;
    float u = dot(U.xyz, p) + U.w, v = dot(V.xyz, p) + V.w;
    bool inside = min(u, v) >= -EDGE && max(u, v) <= 1.0 + EDGE && u + v <= more.y + EDGE;
    return inside && !is_own && t > PROTRUDING * error ? t : -1.0;
}

// From a place in the sphere `viewer`, which is near or far for all of its rays alike.
Met walk_of(Ray ray, vec4 viewer) {
    Met met = Met(0u, NOWHERE, 1.0);
    uint cell = 0u, count = uint(cell_count);
    vec4 viewer_box = vec4(to_boxes(viewer.xyz), viewer.w / BOX_STEP);
    while (cell < count) {
        uint next;
        while (cell < count) {
            Box box = box_of(cell);
            next = box.after;
            bool is_passed = is_missed(box, ray, met.away);
            if (!is_passed && is_apart(viewer_box, 0.5 * (box.low + box.high), box.apart)) break;
            cell = is_passed ? next : cell + 1u;
        }
        if (cell >= count) break;
        float slope, away = find_hit(cell, ray, slope);
        bool is_nearer = away > 0.0 && away < met.away;
        met.cell = is_nearer ? cell : met.cell;
        met.slope = is_nearer ? slope : met.slope;
        met.away = is_nearer ? away : met.away;
        cell = next;
    }
    if (cell != count) unfinished = 1u;
    return met;
}

// A cell that was halved, all in its plane, and how many cells it is: 2^n - 1 of as many levels, halves after each other.
struct Part {
    uint cell, count;
};

// A cell that is not made of halves counts as one.
Part part_of(uint cell) {
    return Part(cell, cells[cell].more.z > 0.0 ? after(cell) - cell : 1u);
}

Part half_at(Part part, vec3 p) {
    vec4 halves = cells[part.cell].halves;
    uint count = part.count / 2u;
    return Part(part.cell + 1u + (dot(halves.xyz, p) + halves.w < 0.0 ? 0u : count), count);
}
