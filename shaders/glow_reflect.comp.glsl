#version 430
// Adds what one drawable's samples reflect of the light that was found for the pixels: Lambert, L = ρ E / π.
layout(local_size_x = 8, local_size_y = 8) in;
#include "alike.glsl"
#include "drawable.glsl"

uniform sampler2D normal_w;
uniform sampler2D uv;
uniform sampler2DArray reflectance; // LAYERS layers over the texture space
uniform sampler2DArray light;       // E / π a pixel, in units of the frame's glow
uniform float glow;
uniform float radius; // of the scene, in m: one unit of the surroundings' distance
layout(std430, binding = 0) readonly buffer Nearness { float nearness[]; }; // sum of 1 / distance met, of the aimless
layout(rgba32f, binding = 0) uniform image2DArray radiance;

const float FEW = 1e-3; // weights whose sum is less find little that is alike

void main() {
    ivec2 at;
    vec3 p_w;
    if (!find_sample(at, p_w)) return;
    vec2 texture_uv = texelFetch(uv, at, 0).zw;
    ivec2 pixel = at / SUPERSAMPLING;
    vec4 E[LAYERS];
    for (int l = 0; l < LAYERS; ++l) E[l] = texelFetch(light, ivec3(pixel, l), 0);
#if SUPERSAMPLING > 1
    // The light of the pixels around that see the same surface; the pixel's own where none does.
    vec3 n = normalize(texelFetch(normal_w, at, 0).xyz);
    ivec2 size = textureSize(light, 0).xy;
    float surroundings = radius * float(max(AIMLESS, 1)) / nearness[pixel.y * size.x + pixel.x];
    vec4 sum[LAYERS];
    float total = 0.0;
    for (int l = 0; l < LAYERS; ++l) sum[l] = vec4(0.0);
    // The four that it lies between, bilinear; where these see other surfaces, all around, alike.
    ivec2 corner = (at - SUPERSAMPLING / 2 + SUPERSAMPLING) / SUPERSAMPLING - 1;
    for (int k = 0; k < 4 + 9 && (k < 4 || total < FEW); ++k) {
        ivec2 near = k < 4 ? corner + ivec2(k % 2, k / 2) : pixel + ivec2((k - 4) % 3 - 1, (k - 4) / 3 - 1);
        ivec2 middle = near * SUPERSAMPLING + SUPERSAMPLING / 2;
        vec4 q = texelFetch(position_w, clamp(middle, ivec2(0), SUPERSAMPLING * size - 1), 0);
        bool is_there = q.w > 0.0 && all(greaterThanEqual(near, ivec2(0))) && all(lessThan(near, size));
        vec2 off = 1.0 - abs(vec2(at - middle)) / float(SUPERSAMPLING);
        float w = (k < 4 ? off.x * off.y : FEW) * alike(p_w, n, q.xyz, normalize(texelFetch(normal_w, middle, 0).xyz));
        // Where all are too far, they still weigh by how near they are.
        w *= is_there ? near_enough(p_w, q.xyz, surroundings) + 1e-3 : 0.0;
        total += w;
        for (int l = 0; l < LAYERS; ++l) sum[l] += w * texelFetch(light, ivec3(near, l), 0);
    }
    if (total > 1e-6)
        for (int l = 0; l < LAYERS; ++l) E[l] = sum[l] / total;
#endif
    for (int l = 0; l < LAYERS; ++l) {
        ivec3 where = ivec3(at, l);
        vec4 rho = textureLod(reflectance, vec3(texture_uv, l), 0.0);
        imageStore(radiance, where, imageLoad(radiance, where) + glow * rho * E[l]);
    }
}
