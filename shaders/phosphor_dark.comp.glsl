#version 430
// One exact step without light, of any length: the shares are the same for every texel, computed in float64 on the
// host.
layout(local_size_x = 64) in;
#include "state_texture.glsl"

uniform vec4 stay; // 1, and `move` is minus the share that is lost; or 0, and `move` is the share that is kept
uniform vec4 move;

void main() {
    ivec2 texel = ivec2(gl_GlobalInvocationID.xy);
    if (texel.x >= imageSize(r_out).x) return;
    STATE r = load_state(texel);
    store_state(texel, r, OF_STATES(stay) * r, OF_STATES(move) * r);
}
