#version 430
// The bounced z-buffer (BZB 2015, 3.2): of all surfels that a pixel's ray meets in the shell of this level, the nearest.
//
// Depth and surfel share a word, depth first, so that the least word is the nearest surfel's, whatever is drawn first.
flat in uint v_surfel;
flat in vec4 v_place; // w: the square of the radius within which it is hit
flat in vec3 v_facing;

layout(std430, binding = 2) buffer Depths { uint depths[]; };                  // DIRECTIONS a pixel
layout(std430, binding = 3) readonly buffer Directions { uint directions[]; }; // DIRECTIONS a pixel
uniform sampler2D shuffled_position;
uniform sampler2D shuffled_normal;
uniform int row;
uniform int level;
uniform vec2 shell;     // where hits may be, as distances along the ray
uniform int surfel_bits;

#include "bounces.glsl"

const float COPLANAR = 2e-5, PARALLEL = 0.8, RIM = 2.0;

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    vec4 p = texelFetch(shuffled_position, at, 0);
    vec3 to = v_place.xyz - p.xyz;
    if (p.w == 0.0) return;
    // No hit is farther from the disk's centre than its radius: so far, so near, or so low under the horizon is none.
    float away = length(to), radius = sqrt(v_place.w);
    vec3 n = texelFetch(shuffled_normal, at, 0).xyz;
    if (away > shell.y + radius || away < shell.x - radius || dot(to, n) < -radius) return;
    float height = dot(to, v_facing);
    // The receiver's own surface.
    if (abs(height) < COPLANAR && abs(dot(v_facing, n)) > PARALLEL) return;
    float steps = float((1u << (32 - surfel_bits)) - 3u);
    int first = (at.y * row + at.x) * DIRECTIONS;
    for (int k = 0; k < DIRECTIONS; ++k) {
        vec3 d = unpack_direction(directions[first + k]);
        float t = height / dot(d, v_facing);
        vec3 off = t * d - to;
        // Disks protrude from the edges of what they stand for: a back so near is that of the receiver's own body.
        bool rim = height > 0.0 && t < RIM * radius;
        if (t >= shell.x && t < shell.y && dot(off, off) < v_place.w && !rim) {
            uint depth = 1u + uint(t / shell.y * steps);
            atomicMin(depths[first + k], (depth << surfel_bits) | v_surfel);
        }
    }
}
