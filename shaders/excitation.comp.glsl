#version 430
// a_i = sum over bands of ke_ij E_j dλ_j, per atlas texel (Nalbach 2017, eq. 8.1), into one layer.
layout(local_size_x = 8, local_size_y = 8) in;

uniform sampler2DArray irradiance; // LAYERS layers over the atlas
uniform sampler2DArray ke_width;   // STATES x LAYERS layers over the material's texture space: ke dλ
uniform sampler2D atlas_uv;
uniform int layer;
// In 1/s: the largest ke times the largest irradiance of a scene. A point nearer to a lamp than that is saturated.
const float LARGEST = 1e15;

layout(IMAGE_FORMAT, binding = 0) writeonly uniform image2DArray excitation;

void main() {
    ivec2 texel = ivec2(gl_GlobalInvocationID.xy);
    if (any(greaterThanEqual(texel, imageSize(excitation).xy))) return;
    vec2 uv = texelFetch(atlas_uv, texel, 0).xy;
    vec4 a = vec4(0.0);
    for (int l = 0; l < LAYERS; ++l) {
        vec4 E = texelFetch(irradiance, ivec3(texel, l), 0);
        for (int i = 0; i < STATES; ++i)
            a[i] += dot(textureLod(ke_width, vec3(uv, i * LAYERS + l), 0.0), E);
    }
    imageStore(excitation, ivec3(texel, layer), min(a, LARGEST));
}
