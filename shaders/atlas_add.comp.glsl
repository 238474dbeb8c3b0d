#version 430
// Adds to the irradiance of every texel of an atlas what was found for a few: those around it that lie on its surface.
layout(local_size_x = 8, local_size_y = 8) in;

uniform sampler2D position_w;   // of the atlas; w: 1 where the mesh covers the texel
uniform sampler2D normal_w;
uniform sampler2D few_position; // of those few; w: 0 where there is none
uniform sampler2D few_normal;
layout(std430, binding = 0) readonly buffer Light { vec4 light[]; }; // LAYERS each: E / π
uniform float scale;
layout(rgba32f, binding = 0) uniform image2DArray irradiance;

const float PI = 3.14159265;

void main() {
    ivec2 texel = ivec2(gl_GlobalInvocationID.xy), size = textureSize(position_w, 0), few = textureSize(few_position, 0);
    if (any(greaterThanEqual(texel, size)) || texelFetch(position_w, texel, 0).w == 0.0) return;
    vec3 p = texelFetch(position_w, texel, 0).xyz, n = normalize(texelFetch(normal_w, texel, 0).xyz);
    vec2 at = (vec2(texel) + 0.5) / vec2(size) * vec2(few) - 0.5;
    ivec2 base = ivec2(floor(at));
    vec4 E[LAYERS];
    for (int l = 0; l < LAYERS; ++l) E[l] = vec4(0.0);
    float total = 0.0, nearest = 1e30;
    int best = -1;
    for (int k = 0; k < 16; ++k) {
        ivec2 one = base + ivec2(k % 4, k / 4) - 1;
        if (any(lessThan(one, ivec2(0))) || any(greaterThanEqual(one, few))) continue;
        vec4 q = texelFetch(few_position, one, 0);
        if (q.w == 0.0) continue;
        // Another chart may lie beside this one in the atlas: what counts is the surface.
        float alike = dot(n, texelFetch(few_normal, one, 0).xyz), away = distance(p, q.xyz) / max(alike, 1e-3);
        if (away < nearest) {
            nearest = away;
            best = one.y * few.x + one.x;
        }
        vec2 tent = max(1.0 - abs(at - vec2(one)), 0.0);
        float w = tent.x * tent.y * max(alike - 0.5, 0.0);
        total += w;
        for (int l = 0; l < LAYERS; ++l) E[l] += w * light[(one.y * few.x + one.x) * LAYERS + l];
    }
    if (best < 0) return;
    for (int l = 0; l < LAYERS; ++l) {
        vec4 found = total > 1e-3 ? E[l] / total : light[best * LAYERS + l];
        ivec3 where = ivec3(texel, l);
        imageStore(irradiance, where, imageLoad(irradiance, where) + PI * scale * found);
    }
}
