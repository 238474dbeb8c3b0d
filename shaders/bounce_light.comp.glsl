#version 430
// The mean radiance that a pixel's directions meet, by their weights and in units of the frame's glow: E / π. Weights are
// those of Lambert's BRDF times cosine; the reflectance is applied where the light is reflected.
layout(local_size_x = 8, local_size_y = 8) in;
#include "receivers.glsl"
#include "surfels.glsl"
#include "bounces.glsl"

layout(std430, binding = 0) readonly buffer Surfels { Surfel surfels[]; };
layout(std430, binding = 1) readonly buffer Radiances { vec4 radiances[]; }; // LAYERS a side
layout(std430, binding = 6) readonly buffer Hits { uint hits[]; };
layout(std430, binding = 7) writeonly buffer Nearness { float nearness[]; }; // sum of 1 / distance met, of the aimless
layout(std430, binding = 8) readonly buffer Looks { uvec2 looks[]; }; // direction and weight; DIRECTIONS a pixel
layout(rgba32f, binding = 0) writeonly uniform image2DArray light;

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy), size = imageSize(light).xy;
    if (any(greaterThanEqual(pixel, size))) return;
    vec4 L[LAYERS];
    for (int l = 0; l < LAYERS; ++l) L[l] = vec4(0.0);
    vec3 p, n;
    bool there = find_receiver(pixel, p, n);
    float near = 1e-20;
    int first = (pixel.y * size.x + pixel.x) * DIRECTIONS;
    for (int k = 0; there && k < DIRECTIONS; ++k) {
        uint hit = hits[first + k];
        if (hit == 0u) continue;
        uint surfel = surfel_of(hit);
        float height = dot(surfels[surfel].place.xyz - p, surfels[surfel].facing.xyz);
        float cosine = dot(unpack_direction(looks[first + k].x), surfels[surfel].facing.xyz);
        if (k < AIMLESS) near += abs(cosine / height);
        // A back blocks, and is dark where surfels send what glows alone.
        uint side = cosine < 0.0 ? 0u : 1u;
        if (side >= uint(SIDES)) continue;
        float weight = uintBitsToFloat(looks[first + k].y);
        for (int l = 0; l < LAYERS; ++l) L[l] += weight * radiances[(surfel * uint(SIDES) + side) * uint(LAYERS) + uint(l)];
    }
    nearness[pixel.y * size.x + pixel.x] = near;
    for (int l = 0; l < LAYERS; ++l) imageStore(light, ivec3(pixel, l), L[l] / float(DIRECTIONS));
}
