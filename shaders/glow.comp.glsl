#version 430
// Adds what a phosphor gives off: L = sum over states of Λ_ij kr_i r_i (Nalbach 2017, eq. 8.3).
layout(local_size_x = 8, local_size_y = 8) in;
#include "drawable.glsl"

uniform sampler2D uv;
uniform sampler2D r;              // over the atlas
uniform sampler2D kr;             // over the texture space
uniform sampler2DArray emission;  // Λ, STATES x LAYERS layers over the texture space
layout(rgba32f, binding = 0) uniform image2DArray radiance;

void main() {
    ivec2 at;
    vec3 p_w;
    if (!find_sample(at, p_w)) return;
    vec4 where = texelFetch(uv, at, 0);
    vec4 decays = textureLod(kr, where.zw, 0.0) * textureLod(r, where.xy, 0.0);
    for (int l = 0; l < LAYERS; ++l) {
        vec4 L = imageLoad(radiance, ivec3(at, l));
        for (int i = 0; i < STATES; ++i)
            L += decays[i] * textureLod(emission, vec3(where.zw, i * LAYERS + l), 0.0);
        imageStore(radiance, ivec3(at, l), L);
    }
}
