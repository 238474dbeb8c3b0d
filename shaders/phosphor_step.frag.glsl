#version 430
// One step of every texel's rate equations, by the solver that the host chose (Nalbach 2017, eq. 8.1 and 8.5).
// KR_MAP: the rates vary over the surface.
#include "SOLVER"

uniform sampler2D r_in;
uniform sampler2D excitation; // a_i in 1/s
uniform float dt;             // s
#ifdef KR_MAP
uniform sampler2D atlas_uv;
uniform sampler2D kr_map;
#else
uniform vec4 kr; // 1/s
#endif
out vec4 r_out;

void main() {
    ivec2 texel = ivec2(gl_FragCoord.xy);
#ifdef KR_MAP
    vec4 kr = textureLod(kr_map, texelFetch(atlas_uv, texel, 0).xy, 0.0);
#endif
    r_out = step_state(texelFetch(r_in, texel, 0), texelFetch(excitation, texel, 0), kr, dt);
}
