// The exact step under constant excitation (solution of Nalbach 2017, eq. 8.1):
//     k = a + kr,  r_inf = a / k,  r' = r_inf + (r - r_inf) exp(-k dt)
#include "exponential.glsl"

vec4 step_state(vec4 r, vec4 a, vec4 kr, float dt) {
    vec4 k = a + kr;
    vec4 x = min(k * dt, X_MAX);
    vec4 e, g;
    exp_minus(x, e, g);
    vec4 r_inf = mix(r, a / k, greaterThan(k, vec4(0.0)));
    // A small step adds an increment, so that r keeps its last bits; a large one mixes, so that nothing cancels.
    vec4 stepped = mix(r * e + r_inf * g, r + (r_inf - r) * g, lessThan(x, vec4(0.34)));
    return clamp(stepped, min(r, r_inf), max(r, r_inf));
}
