#version 430
// Exclusive sums of 64-bit integers, in place: chunks are summed, then each is spread from what came before it.
layout(local_size_x = 64) in;
#include "items.glsl"

layout(std430, binding = 0) buffer Values { uvec2 values[]; }; // low word first
layout(std430, binding = 1) buffer Chunks { uvec2 chunks[]; };
uniform uint count; // of the values
uniform bool has_chunks;

uvec2 add(uvec2 a, uvec2 b) {
    uint carry;
    uint low = uaddCarry(a.x, b.x, carry);
    return uvec2(low, a.y + b.y + carry);
}

void main() {
    uint chunk = item_number(), begin = chunk * uint(CHUNK);
    if (begin >= count) return;
    uint end = min(begin + uint(CHUNK), count);
#ifdef SPREAD
    uvec2 sum = has_chunks ? chunks[chunk] : uvec2(0u);
    for (uint k = begin; k < end; ++k) {
        uvec2 value = values[k];
        values[k] = sum;
        sum = add(sum, value);
    }
#else
    uvec2 sum = uvec2(0u);
    for (uint k = begin; k < end; ++k) sum = add(sum, values[k]);
    chunks[chunk] = sum;
#endif
}
