#version 430
// One step of every texel's rate equations, by the solver that the host chose (Nalbach 2017, eq. 8.1 and 8.5).
// KR_MAP: the rates vary over the surface.
#include "state_texture.glsl"
#include "drive.glsl"
#include "SOLVER"

uniform sampler2DArray excitation; // a_i in 1/s at factor 1: one layer a light, or lights that run alike
uniform vec3 course_dt[LIGHTS];    // each layer's factor times dt, as a quadratic in the share of the step
#ifdef KR_MAP
uniform sampler2D atlas_uv;
uniform sampler2D kr_map; // 1/s
uniform float dt;         // s
#else
uniform vec4 kr_dt; // computed in float64
#endif

void at_texel(ivec2 texel) {
#ifdef KR_MAP
    vec4 kr_dt = max(textureLod(kr_map, texelFetch(atlas_uv, texel, 0).xy, 0.0) * dt, SLOWEST);
#endif
    Drive drive = Drive(STATE(0.0), STATE(0.0), STATE(0.0));
    for (int l = 0; l < LIGHTS; ++l) {
        STATE a = OF_STATES(texelFetch(excitation, ivec3(texel, l), 0));
        drive.a0 += course_dt[l].x * a;
        drive.a1 += course_dt[l].y * a;
        drive.a2 += course_dt[l].z * a;
    }
    STATE r = load_state(texel), from, change;
    step_state(r, OF_STATES(kr_dt), drive, from, change);
    store_state(texel, r, from, change);
}

#include "texels.glsl"
