#version 430
// One step without light, of any length: every texel keeps the same share, computed in float64 on the host.
layout(local_size_x = 64) in;
#include "state.glsl"

uniform sampler2D r_in;
uniform vec4 keep;
layout(STATE_FORMAT, binding = 0) writeonly uniform image2D r_out;

void main() {
    ivec2 texel = ivec2(gl_GlobalInvocationID.xy);
    if (texel.x >= imageSize(r_out).x) return;
    STATE r = OF_STATES(texelFetch(r_in, texel, 0));
    imageStore(r_out, texel, TO_FOUR(OF_STATES(keep) * r));
}
