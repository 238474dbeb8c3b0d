#version 430
// Where each pixel looks: AIMLESS directions whose density is that of BRDF times cosine, cos / π for Lambert, and others
// that aim at what glows. Together they are one sample by the balance heuristic (Veach and Guibas 1995): each counts as
// cos / π over the density of all, so that what one way of choosing seldom finds does not weigh much when it is found.
layout(local_size_x = 8, local_size_y = 8) in;
#include "receivers.glsl"
#include "hemisphere.glsl"
#include "bounces.glsl"
#include "guides.glsl"

layout(std430, binding = 5) readonly buffer Points { vec2 points[]; }; // of the unit square; DIRECTIONS a place
layout(std430, binding = 8) writeonly buffer Looks { uvec2 looks[]; }; // direction and weight; DIRECTIONS a pixel

vec3 around(vec3 axis, vec3 w) {
    vec3 x, y;
    find_basis(axis, x, y);
    return w.x * x + w.y * y + w.z * axis;
}

// A direction evenly within the cone of one guide, which is chosen by what it may bring; `hope` is that of all.
vec3 aim(vec2 u, float hope, vec3 p, vec3 n) {
    float wanted = u.x * hope;
    Cone chosen;
    for (int g = 0; g < GUIDES; ++g) {
        Cone cone = find_cone(g, p, n);
        if (cone.hope == 0.0) continue;
        chosen = cone;
        if (wanted < cone.hope) break;
        wanted -= cone.hope;
    }
    // What is left of u.x is as random as it was.
    float z = 1.0 - clamp(wanted / chosen.hope, 0.0, 1.0) * (1.0 - chosen.cosine), angle = 6.28318531 * u.y;
    return around(chosen.axis, vec3(sqrt(max(1.0 - z * z, 0.0)) * vec2(cos(angle), sin(angle)), z));
}

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy), size = picture_size();
    if (any(greaterThanEqual(pixel, size))) return;
    int first = (pixel.y * size.x + pixel.x) * DIRECTIONS;
    vec3 p, n;
    bool there = find_receiver(pixel, p, n);
    float hope = 0.0;
    if (there && AIMLESS < DIRECTIONS)
        for (int g = 0; g < GUIDES; ++g) hope += find_cone(g, p, n).hope;
    float aimed = hope > 0.0 ? float(DIRECTIONS - AIMLESS) / float(DIRECTIONS) : 0.0;
    for (int k = 0; k < DIRECTIONS; ++k) {
        vec2 u = points[((pixel.y % PATTERN) * PATTERN + pixel.x % PATTERN) * DIRECTIONS + k];
        vec3 d = aimed > 0.0 && k >= AIMLESS ? aim(u, hope, p, n) : around(n, on_hemisphere(u));
        uint word = pack_direction(d);
        d = unpack_direction(word);
        float weight = there ? 1.0 : 0.0;
        if (aimed > 0.0) {
            float density = 0.0, cosine = max(dot(d, n), 0.0) / 3.14159265;
            for (int g = 0; g < GUIDES; ++g) {
                Cone cone = find_cone(g, p, n);
                if (cone.hope > 0.0 && dot(d, cone.axis) >= cone.cosine) density += cone.hope / solid_angle(cone);
            }
            weight = cosine / max(mix(cosine, density / hope, aimed), 1e-20);
        }
        looks[first + k] = uvec2(word, floatBitsToUint(weight));
    }
}
