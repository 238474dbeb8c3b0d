#version 430
// What phosphor_step reads and writes, and no arithmetic: the yardstick of its time.
layout(local_size_x = 64) in;
#include "state_texture.glsl"

uniform sampler2DArray excitation;

void main() {
    ivec2 texel = ivec2(gl_GlobalInvocationID.xy);
    if (texel.x >= imageSize(r_out).x) return;
    // A choice instead of a sum: every channel of both textures must be read, or the compiler drops the fetch.
    STATE a = OF_STATES(texelFetch(excitation, ivec3(texel, 0), 0));
    imageStore(r_out, texel, TO_FOUR(max(load_state(texel), a)));
#ifdef COMPENSATED
    imageStore(low_out, texel, texelFetch(low_in, texel, 0));
#endif
}
