// Where a step reads its state, and where it writes it, in the format that the host chose.
// COMPENSATED: what was read has in `low_in` what rounding kept back from it.
#include "state.glsl"

uniform sampler2D r_in;
#ifdef COMPENSATED
uniform sampler2D low_in;
#endif
layout(IMAGE_FORMAT, binding = 0) writeonly uniform image2D r_out;

#include "FORMAT"

STATE load_state(ivec2 texel) {
    return OF_STATES(texelFetch(r_in, texel, 0));
}

// The new state is from + change, where `from` is the old state r, or what the step ends near.
void store_state(ivec2 texel, STATE r, STATE from, STATE change) {
#ifdef COMPENSATED
    change += mix(STATE(0.0), OF_STATES(texelFetch(low_in, texel, 0)), equal(from, r));
#endif
    store_sum(texel, from, change);
}
