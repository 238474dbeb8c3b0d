#version 430
// The nearest cell in each of a pixel's directions, of those that its group was given: a z-buffer in registers.
layout(local_size_x = 16, local_size_y = 16) in;
#include "receivers.glsl"
#include "tiles.glsl"

struct Test {
    vec4 N, U, V; // distance from the plane, and shares of the sides, of a point
    vec4 more;    // error, the most of u + v
};

layout(std430, binding = 0) readonly buffer Groups { Group groups[]; };
layout(std430, binding = 1) readonly buffer Tests { Test tests[]; };
layout(std430, binding = 2) readonly buffer Ends { uint ends[]; }; // where each group's list begins; one more
layout(std430, binding = 3) readonly buffer Lists { uint lists[]; };
layout(std430, binding = 4) readonly buffer Directions { vec4 directions[]; }; // about +z; DIRECTIONS a place
layout(std430, binding = 5) writeonly buffer Hits { uint hits[]; }; // DIRECTIONS a pixel: cell + 1; 0: dark

uniform ivec2 tiles;

const float PARALLEL = 0.8;
const float EDGE = 1e-5; // neighbouring cells overlap by this share, so that no ray slips between

// An orthonormal basis around n (Duff et al. 2017).
void find_basis(vec3 n, out vec3 x, out vec3 y) {
    float s = n.z >= 0.0 ? 1.0 : -1.0;
    float a = -1.0 / (s + n.z), b = n.x * n.y * a;
    x = vec3(1.0 + s * n.x * n.x * a, s * b, -s * n.x);
    y = vec3(b, s + n.y * n.y * a, -n.y);
}

void main() {
    int tile = int(gl_WorkGroupID.y) * tiles.x + int(gl_WorkGroupID.x);
    int at = 2 * tile + int(gl_WorkGroupID.z);
    Group group = groups[at];
    if (group.count == 0.0) return;
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy), size = picture_size();
    vec3 o, n;
    if (any(greaterThanEqual(pixel, size)) || !find_receiver(pixel, o, n)) return;
    if (group.axis >= 0.0 && (o[int(group.axis)] > group.divide) != (gl_WorkGroupID.z == 1u)) return;

    vec3 x, y, d[DIRECTIONS];
    find_basis(n, x, y);
    int place = (pixel.y % PATTERN) * PATTERN + pixel.x % PATTERN;
    float nearest[DIRECTIONS];
    uint hit[DIRECTIONS];
    for (int k = 0; k < DIRECTIONS; ++k) {
        vec3 w = directions[place * DIRECTIONS + k].xyz;
        d[k] = w.x * x + w.y * y + w.z * n;
        nearest[k] = 1e30;
        hit[k] = 0u;
    }
    uint end = ends[at + 1];
    for (uint m = ends[at]; m < end; ++m) {
        uint cell = lists[m];
        Test test = tests[cell];
        float h = dot(test.N.xyz, o) + test.N.w;
        if (abs(h) < test.more.x) {
            // In the cell's plane, or in the surface that it stands for. Where that is another surface than the
            // receiver's, which meets it in an edge, the receiver is in front.
            if (abs(dot(test.N.xyz, n)) > PARALLEL) continue;
            h = test.more.x;
        }
        float u0 = dot(test.U.xyz, o) + test.U.w, v0 = dot(test.V.xyz, o) + test.V.w;
        uint seen = h > 0.0 ? cell + 1u : 0u; // a back blocks and is dark
        for (int k = 0; k < DIRECTIONS; ++k) {
            float t = -h / dot(test.N.xyz, d[k]);
            float u = u0 + t * dot(test.U.xyz, d[k]), v = v0 + t * dot(test.V.xyz, d[k]);
            if (t > 0.0 && t < nearest[k] && min(u, v) >= -EDGE && max(u, v) <= 1.0 + EDGE
                && u + v <= test.more.y + EDGE) {
                nearest[k] = t;
                hit[k] = seen;
            }
        }
    }
    int first = (pixel.y * size.x + pixel.x) * DIRECTIONS;
    for (int k = 0; k < DIRECTIONS; ++k) hits[first + k] = hit[k];
}
