#version 430
// Widens the charts by one texel: bilinear reads at a chart's edge then find what belongs to it.
// The new texel continues the chart's plane where two texels in a row are there, and copies where only one is.
uniform sampler2D position_in;
uniform sampler2D normal_in;
uniform sampler2D uv_in;
layout(location = 0) out vec4 position_w;
layout(location = 1) out vec4 normal_w;
layout(location = 2) out vec4 texture_uv;

const ivec2 NEAR[8] = ivec2[](ivec2(1, 0), ivec2(-1, 0), ivec2(0, 1), ivec2(0, -1),
                              ivec2(1, 1), ivec2(-1, 1), ivec2(1, -1), ivec2(-1, -1));

void main() {
    ivec2 texel = ivec2(gl_FragCoord.xy);
    ivec2 last = textureSize(position_in, 0) - 1;
    position_w = texelFetch(position_in, texel, 0);
    normal_w = texelFetch(normal_in, texel, 0);
    texture_uv = texelFetch(uv_in, texel, 0);
    for (int k = 0; position_w.w == 0.0 && k < 8; ++k) {
        ivec2 one = clamp(texel + NEAR[k], ivec2(0), last);
        ivec2 two = clamp(texel + 2 * NEAR[k], ivec2(0), last);
        vec4 p = texelFetch(position_in, one, 0);
        if (p.w == 0.0) continue;
        vec4 n = texelFetch(normal_in, one, 0), q = texelFetch(position_in, two, 0);
        vec4 uv = texelFetch(uv_in, one, 0);
        // Two texels of one chart have much the same normal; another chart's would bend the plane.
        bool same = q.w > 0.0 && dot(n, texelFetch(normal_in, two, 0)) > 0.9;
        position_w = same ? vec4(2.0 * p.xyz - q.xyz, 1.0) : p;
        texture_uv = same ? 2.0 * uv - texelFetch(uv_in, two, 0) : uv;
        normal_w = n;
    }
}
