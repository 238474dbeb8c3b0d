#version 430
// What a surfel gives a pixel, in the shell of this level: its form factor times its radiance, added up by blending.
//
// Seen from a point a disk of area A at distance d fills A cos cos' / (π d² + A) of the cosine-weighted hemisphere
// (Wallace, Elmquist and Haines 1989).
flat in vec4 v_place; // w: area
flat in vec3 v_facing;
flat in vec2 v_shell; // squares of its radii
flat in vec4 v_radiance[LAYERS];

uniform sampler2D shuffled_position;
uniform sampler2D shuffled_normal;
layout(location = 0) out vec4 light[LAYERS]; // E / π, in units of the frame's glow

const float PI = 3.14159265;

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    vec4 p = texelFetch(shuffled_position, at, 0);
    vec3 to = p.xyz - v_place.xyz;
    float d2 = dot(to, to);
    float behind = dot(to, v_facing), before = -dot(to, texelFetch(shuffled_normal, at, 0).xyz);
    bool reached = p.w > 0.0 && d2 < v_shell.y && d2 >= v_shell.x && behind > 0.0 && before > 0.0;
    float F = reached ? v_place.w * behind * before / (max(d2, 1e-12) * (PI * d2 + v_place.w)) : 0.0;
    for (int l = 0; l < LAYERS; ++l) light[l] = F * v_radiance[l];
}
