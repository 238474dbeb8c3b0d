#version 430
// The splats of one level: for each surfel the rectangle of its sub-buffer that its shell may reach, if any.
//
// A sphere around the shell is bounded on the screen, and the receivers there, by their boxes, must lie in reach and
// before the surfel. All of it is conservative: what is left out would have been rejected pixel by pixel.
// Without FILL surfels are counted; with it, after prefix sums, the splats are written.
layout(local_size_x = 64) in;
#include "items.glsl"
#include "surfels.glsl"
#include "interleaved.glsl"
#include "shells.glsl"

layout(std430, binding = 0) readonly buffer Surfels { Surfel surfels[]; };
layout(std430, binding = 1) readonly buffer Radiances { vec4 radiances[]; }; // LAYERS a side
layout(std430, binding = 2) readonly buffer Boxes { vec4 boxes[]; };
layout(std430, binding = 3) buffer Sums { uvec2 sums[]; };
layout(std430, binding = 4) writeonly buffer Splats { Splat splats[]; };
uniform uint count;
uniform ivec2 size;         // of the picture in pixels
uniform mat4 to_view;       // surfels to the camera, which looks along -z
uniform vec2 focal;         // pixels at distance 1
uniform float near_limit;   // the nearest depth that is seen
uniform bool culled;        // false: every surfel that may send is splatted all over its sub-buffer
uniform int bounds_levels;
uniform ivec3 bounds[16];   // size and first box of each level of the MIP map; the first is of blocks of 4 x 4

uniform bool last;          // the shell has no end
#ifdef BOUNCED
uniform float first_shell;  // its outer radius, the same for all surfels
uniform float inflation;
#else
uniform float epsilon;
uniform int side; // 0: surfels send to the front; 1: to the back
#endif

const float SLACK = 1e-4; // of rounding, in units of the scene's radius

// The shell's radii around the surfel's centre, as receivers' distances; false: it sends to no one.
bool find_shell(Surfel s, uint k, out float inner, out float outer) {
    float wider = float(1 << level);
#ifdef BOUNCED
    // What is hit is within the shell, and no farther from the centre than the enlarged disk is wide.
    float disk = s.place.w * wider * inflation;
    inner = level == 0 ? 0.0 : max(0.5 * first_shell * wider - disk, 0.0);
    outer = (last ? 2.0 : first_shell * wider) + disk;
    return true;
#else
    float L = 0.0;
    for (int l = 0; l < LAYERS; ++l) {
        vec4 v = radiances[(k * uint(SIDES) + uint(side)) * uint(LAYERS) + uint(l)];
        L = max(L, max(max(v.x, v.y), max(v.z, v.w)));
    }
    outer = sqrt(first_reach2(s.place.w, L, epsilon)) * wider;
    inner = level == 0 ? 0.0 : 0.5 * outer;
    if (last) outer = max(outer, sqrt(ACROSS2));
    return L > 0.0;
#endif
}

// Pixels along one axis that a sphere at (a, depth) may cover (Mara and McGuire 2013).
vec2 find_span(float a, float depth, float r, float focal, float size) {
    float t2 = a * a + depth * depth - r * r, before = depth * depth - r * r;
    if (depth <= r * 1.001 || t2 <= 0.0) return vec2(0.0, size);
    float root = r * sqrt(t2);
    vec2 span = vec2(a * depth - root, a * depth + root) / before;
    return span * focal + 0.5 * size;
}

bool boxes_in_reach(Surfel s, float inner, float outer, ivec4 pixels) {
    int m = 0;
    while (m + 1 < bounds_levels && any(greaterThan((pixels.zw >> (m + 2)) - (pixels.xy >> (m + 2)), ivec2(1)))) ++m;
    ivec2 first = pixels.xy >> (m + 2), last = pixels.zw >> (m + 2);
    for (int y = first.y; y <= last.y; ++y)
        for (int x = first.x; x <= last.x; ++x) {
            int at = 2 * (bounds[m].z + y * bounds[m].x + x);
            vec3 low = boxes[at].xyz, high = boxes[at + 1].xyz;
            if (low.x > high.x) continue;
            vec3 c = s.place.xyz;
            vec3 gap = max(max(low - c, c - high), 0.0), across = max(abs(low - c), abs(high - c));
            if (length(gap) > outer + SLACK || length(across) < inner - SLACK) continue;
#ifndef BOUNCED
            // The corner farthest along the normal is behind: so are all.
            vec3 n = float(1 - 2 * side) * s.facing.xyz, corner = mix(low, high, greaterThan(n, vec3(0.0)));
            if (dot(n, corner - c) < -SLACK) continue;
#endif
            return true;
        }
    return false;
}

void main() {
    uint k = item_number();
    if (k >= count) return;
    Surfel s = surfels[k];
    ivec2 blocks = count_blocks(size);
    ivec4 in_blocks = ivec4(0, 0, blocks); // first, and after the last
    float inner, outer;
    bool wanted = find_shell(s, k, inner, outer);
    if (wanted && culled) {
        vec3 p = (to_view * vec4(s.place.xyz, 1.0)).xyz;
        if (-p.z + outer + SLACK < near_limit) wanted = false;
        vec2 x = find_span(p.x, -p.z, outer + SLACK, focal.x, float(size.x));
        vec2 y = find_span(p.y, -p.z, outer + SLACK, focal.y, float(size.y));
        ivec4 pixels = ivec4(floor(vec4(x.x, y.x, x.y, y.y) + vec4(-1.0, -1.0, 1.0, 1.0)));
        pixels = ivec4(max(pixels.xy, ivec2(0)), min(pixels.zw, size - 1));
        wanted = wanted && all(lessThanEqual(pixels.xy, pixels.zw)) && boxes_in_reach(s, inner, outer, pixels);
        in_blocks = ivec4(pixels.xy >> level, (pixels.zw >> level) + 1);
    }
#ifdef FILL
    if (!wanted) return;
    // Each of 4^l surfels in a row has a sub-buffer of its own, in an order that is random each time: round robin would
    // beat with the sequence that places them. The quad is cut to its sub-buffer.
    uint shuffle = hash(uvec3(k >> (2 * level), seed, uint(level))).x >> 8u;
    ivec2 sub = ivec2(k ^ shuffle, (k ^ shuffle) >> level) & ((1 << level) - 1);
    ivec2 corner = sub * blocks;
    uint at = sums[k].x;
    splats[at].rectangle = in_blocks + ivec4(corner, corner);
    splats[at].surfel = k;
#else
    sums[k] = uvec2(wanted ? 1u : 0u, 0u);
#endif
}
