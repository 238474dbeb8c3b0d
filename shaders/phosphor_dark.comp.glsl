#version 430
// One exact step without light, of any length: the shares are the same for every texel, computed in float64 on the
// host.
#include "state_texture.glsl"

uniform vec4 stay; // 1, and `move` is minus the share that is lost; or 0, and `move` is the share that is kept
uniform vec4 move;

void at_texel(ivec2 texel) {
    STATE r = load_state(texel);
    store_state(texel, r, OF_STATES(stay) * r, OF_STATES(move) * r);
}

#include "texels.glsl"
