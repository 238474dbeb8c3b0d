#version 430
// What each texel of a phosphor's atlas gives off: L = sum over states of Λ_ij kr_i r_i (Nalbach 2017, eq. 8.3).
layout(local_size_x = 8, local_size_y = 8) in;

uniform sampler2D r;              // over the atlas
uniform sampler2D atlas_uv;       // texture coordinates of the texels
uniform sampler2D kr;             // over the texture space
uniform sampler2DArray emission;  // Λ, STATES x LAYERS layers over the texture space
layout(rgba32f, binding = 0) writeonly uniform image2DArray radiance;

void main() {
    ivec2 texel = ivec2(gl_GlobalInvocationID.xy);
    if (any(greaterThanEqual(texel, imageSize(radiance).xy))) return;
    vec2 uv = texelFetch(atlas_uv, texel, 0).xy;
    vec4 decays = textureLod(kr, uv, 0.0) * texelFetch(r, texel, 0);
    for (int l = 0; l < LAYERS; ++l) {
        vec4 L = vec4(0.0);
        for (int i = 0; i < STATES; ++i)
            L += decays[i] * textureLod(emission, vec3(uv, i * LAYERS + l), 0.0);
        imageStore(radiance, ivec3(texel, l), L);
    }
}
