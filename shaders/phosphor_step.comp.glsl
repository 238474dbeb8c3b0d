#version 430
// One step of every texel's rate equations, by the solver that the host chose (Nalbach 2017, eq. 8.1 and 8.5).
// KR_MAP: the rates vary over the surface.
layout(local_size_x = 64) in; // a row of texels: an eighth faster than a square on a CPU rasterizer
#include "state.glsl"
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
layout(STATE_FORMAT, binding = 0) writeonly uniform image2D r_out;

void main() {
    ivec2 texel = ivec2(gl_GlobalInvocationID.xy);
    if (texel.x >= imageSize(r_out).x) return;
#ifdef KR_MAP
    vec4 kr = textureLod(kr_map, texelFetch(atlas_uv, texel, 0).xy, 0.0);
#endif
    STATE r = OF_STATES(texelFetch(r_in, texel, 0));
    STATE a = OF_STATES(texelFetch(excitation, texel, 0));
    imageStore(r_out, texel, TO_FOUR(step_state(r, a, OF_STATES(kr), dt)));
}
