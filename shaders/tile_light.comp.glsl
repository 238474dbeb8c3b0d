#version 430
// The weighted mean of the radiance that pixels' directions meet, in units of the frame's glow: E / π.
layout(local_size_x = 64) in;
#include "items.glsl"

layout(std430, binding = 0) readonly buffer Hits { uvec2 hits[]; };      // DIRECTIONS a pixel: 1 + 2 cell + back, or 0; weight
layout(std430, binding = 1) readonly buffer Radiances { vec4 cells[]; }; // LAYERS a side, front and back of each
layout(std430, binding = 2) readonly buffer Pixels { uint pixels[]; };   // in rows
layout(rgba32f, binding = 0) uniform image2DArray light;
uniform int count;   // of the pixels
uniform float share; // of these directions in all of theirs: what is there already is of the others

void main() {
    int item = int(item_number());
    if (item >= count) return;
    int width = imageSize(light).x, number = int(pixels[item]);
    ivec2 pixel = ivec2(number % width, number / width);
    vec4 L[LAYERS];
    for (int l = 0; l < LAYERS; ++l) L[l] = vec4(0.0);
    for (int k = 0; k < DIRECTIONS; ++k) {
        uvec2 hit = hits[item * DIRECTIONS + k];
        if (hit.x > 0u)
            for (int l = 0; l < LAYERS; ++l) L[l] += uintBitsToFloat(hit.y) * cells[(hit.x - 1u) * LAYERS + l];
    }
    for (int l = 0; l < LAYERS; ++l) {
        ivec3 at = ivec3(pixel, l);
        vec4 others = share < 1.0 ? imageLoad(light, at) : vec4(0.0);
        imageStore(light, at, mix(others, L[l] / float(DIRECTIONS), share));
    }
}
