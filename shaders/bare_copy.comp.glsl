#version 430
// What phosphor_step reads and writes, and no arithmetic: the yardstick of its time.
#include "state_texture.glsl"

uniform sampler2DArray excitation;

void at_texel(ivec2 texel) {
    // A choice instead of a sum: every channel of both textures must be read, or the compiler drops the fetch.
    STATE a = OF_STATES(texelFetch(excitation, ivec3(texel, 0), 0));
    imageStore(r_out, texel, TO_FOUR(max(load_state(texel), a)));
#ifdef COMPENSATED
    imageStore(low_out, texel, texelFetch(low_in, texel, 0));
#endif
}

#include "texels.glsl"
