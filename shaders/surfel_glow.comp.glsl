#version 430
// What the surfels of one phosphor send to the front: the mean of its atlas over as many texels as a surfel has area.
layout(local_size_x = 64) in;
#include "items.glsl"
#include "surfels.glsl"

layout(std430, binding = 0) readonly buffer Surfels { Surfel surfels[]; };
layout(std430, binding = 1) writeonly buffer Radiances { vec4 radiances[]; }; // LAYERS a side, SIDES a surfel
uniform sampler2DArray covered; // LAYERS, and one more with the share of texels that count
uniform vec2 share; // that the atlas takes of it
uniform float number;
uniform uint count;

void main() {
    uint k = item_number();
    if (k >= count || surfels[k].facing.w != number) return;
    vec4 texel = surfels[k].texel;
    texel.xy *= share;
    float cover = textureLod(covered, vec3(texel.xy, LAYERS), texel.z).x;
    for (int l = 0; l < LAYERS; ++l)
        radiances[k * SIDES * LAYERS + l] = textureLod(covered, vec3(texel.xy, l), texel.z) / max(cover, 1e-6);
}
