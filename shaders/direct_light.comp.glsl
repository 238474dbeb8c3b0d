#version 430
// Radiance that one drawable's samples reflect of the punctual lights: Lambert, L = ρ E / π.
layout(local_size_x = 8, local_size_y = 8) in;
#include "lights.glsl"
#include "drawable.glsl"

uniform sampler2D normal_w;
uniform sampler2D uv;
uniform sampler2DArray reflectance; // LAYERS layers over the texture space
layout(rgba32f, binding = 0) writeonly uniform image2DArray radiance;

const float INV_PI = 0.318309886;

void main() {
    ivec2 at;
    vec3 p_w;
    if (!find_sample(at, p_w)) return;
    vec2 texture_uv = texelFetch(uv, at, 0).zw;
    vec4 E[LAYERS];
    for (int l = 0; l < LAYERS; ++l) E[l] = vec4(0.0);
    if (drawable > 0.0) gather_irradiance(p_w, texelFetch(normal_w, at, 0).xyz, E);
    for (int l = 0; l < LAYERS; ++l) {
        vec4 rho = textureLod(reflectance, vec3(texture_uv, l), 0.0);
        imageStore(radiance, ivec3(at, l), rho * E[l] * INV_PI);
    }
}
