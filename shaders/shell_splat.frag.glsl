#version 430
// What a surfel gives a pixel, in the shell of this level: its form factor times its radiance, added up by blending.
//
// Seen from a point a disk of area A at distance d fills A cos cos' / (π d² + A) of the cosine-weighted hemisphere
// (Wallace, Elmquist and Haines 1989). On level l a pixel meets one of 4^l surfels, which stands for all of them: the
// light is multiplied, where the papers enlarge the disk, so that the mean over the sub-buffers is that of the surfels.
flat in uint v_surfel;
flat in vec4 v_place;
flat in vec3 v_facing;

layout(std430, binding = 1) readonly buffer Radiances { vec4 radiances[]; };
uniform sampler2D shuffled_position;
uniform sampler2D shuffled_normal;
uniform int level;
uniform float epsilon;
layout(location = 0) out vec4 light[LAYERS]; // E / π, in units of the frame's glow

const float PI = 3.14159265;

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    vec4 p = texelFetch(shuffled_position, at, 0);
    vec3 to = p.xyz - v_place.xyz;
    float d2 = dot(to, to), r2 = v_place.w * v_place.w;
    float behind = dot(to, v_facing), before = -dot(to, texelFetch(shuffled_normal, at, 0).xyz);
    vec4 L[LAYERS];
    float most = 0.0;
    for (int l = 0; l < LAYERS; ++l) {
        L[l] = radiances[v_surfel * uint(LAYERS) + uint(l)];
        most = max(most, max(max(L[l].x, L[l].y), max(L[l].z, L[l].w)));
    }
    // Where the form factor, face to face, times the brightest band falls below epsilon the first shell ends.
    float wider = float(1 << (2 * level));
    float outer2 = r2 * max(most / epsilon - 1.0, 0.0) * wider, inner2 = level == 0 ? 0.0 : 0.25 * outer2;
    if (p.w == 0.0 || d2 >= outer2 || d2 < inner2 || behind <= 0.0 || before <= 0.0) discard;
    float A = PI * r2;
    float F = A * behind * before / (max(d2, 1e-12) * (PI * d2 + A)) * wider;
    for (int l = 0; l < LAYERS; ++l) light[l] = F * L[l];
}
