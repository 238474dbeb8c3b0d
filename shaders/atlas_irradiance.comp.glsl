#version 430
// K-band irradiance from the punctual lights at every atlas texel (Nalbach 2017, 8.5).
layout(local_size_x = 8, local_size_y = 8) in;
#include "lights.glsl"

uniform sampler2D position_w; // w: 1 where the mesh covers the texel
uniform sampler2D normal_w;
layout(rgba32f, binding = 0) writeonly uniform image2DArray irradiance;

void main() {
    ivec2 texel = ivec2(gl_GlobalInvocationID.xy);
    if (any(greaterThanEqual(texel, textureSize(position_w, 0)))) return;
    vec4 p_w = texelFetch(position_w, texel, 0);
    vec4 E[LAYERS];
    for (int l = 0; l < LAYERS; ++l) E[l] = vec4(0.0);
    if (p_w.w > 0.0) gather_irradiance(p_w.xyz, texelFetch(normal_w, texel, 0).xyz, E);
    for (int l = 0; l < LAYERS; ++l) imageStore(irradiance, ivec3(texel, l), E[l]);
}
