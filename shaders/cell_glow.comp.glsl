#version 430
// The mean radiance of each of the smallest cells of one phosphor: that of its texels, weighted by their areas. At most
// PART texels of each are added at a time.
layout(local_size_x = 64) in;
#include "items.glsl"

uniform sampler2DArray radiance;
uniform int first; // leaf
uniform int count;
uniform uint part; // the first texel of each that is added now

layout(std430, binding = 0) readonly buffer Ends { uint end_of[]; };    // of each leaf's texels in the list; [0] is 0
layout(std430, binding = 1) readonly buffer Texels { uvec4 texels[]; }; // x, y, share as the bits of a float
layout(std430, binding = 2) buffer Leaves { vec4 leaves[]; }; // LAYERS a leaf

void main() {
    int leaf = int(item_number());
    if (leaf >= count) return;
    vec4 L[LAYERS];
    for (int l = 0; l < LAYERS; ++l) L[l] = part == 0u ? vec4(0.0) : leaves[(first + leaf) * LAYERS + l];
    uint begin = end_of[leaf] + part, end = min(begin + uint(PART), end_of[leaf + 1]);
    for (uint k = begin; k < end; ++k) {
        uvec4 texel = texels[k];
        float share = uintBitsToFloat(texel.z);
        for (int l = 0; l < LAYERS; ++l) L[l] += share * texelFetch(radiance, ivec3(texel.xy, l), 0);
    }
    for (int l = 0; l < LAYERS; ++l) leaves[(first + leaf) * LAYERS + l] = L[l];
}
