// Punctual lights and their shadows: the one place that says how much light reaches a point.

struct Light {
    vec4 position_w;  // w: kind
    vec4 direction_w; // w: world size of a shadow texel at depth 1
    vec4 cone;        // x, y: scale and offset of the cosine (KHR_lights_punctual); z: first view; w: factor, 0 if off
};
layout(std430, binding = 0) readonly buffer Lights { Light lights[]; };
layout(std430, binding = 1) readonly buffer Views { mat4 world_to_clip[]; };
layout(std430, binding = 2) readonly buffer Spectra { vec4 irradiance_at_1m[]; }; // LAYERS a light

uniform int light_count;
uniform sampler2DShadow shadow_sheet; // one square tile a view
uniform int tiles_per_side;

const float DIRECTIONAL = 0.0;
const float ONE_VIEW = 1.0;  // a spot
const float SIX_VIEWS = 2.0; // a point, or a spot too wide for one view

// A point light has no size: nearer than this, in m, its irradiance grows no more and stays a number.
const float NEAREST = 1e-6;

// Irradiance at the point over that at 1 m on the light's axis, without shadow; L is the direction to the light.
float attenuation(Light light, vec3 p_w, vec3 normal_w, out vec3 L) {
    if (light.position_w.w == DIRECTIONAL) {
        L = -light.direction_w.xyz;
        return max(dot(normal_w, L), 0.0);
    }
    vec3 d = light.position_w.xyz - p_w;
    float square = max(dot(d, d), NEAREST * NEAREST);
    L = d / sqrt(square);
    float c = clamp(dot(-L, light.direction_w.xyz) * light.cone.x + light.cone.y, 0.0, 1.0);
    return c * c * max(dot(normal_w, L), 0.0) / square;
}

int view_of(Light light, vec3 p_w) {
    int first = int(light.cone.z);
    if (light.position_w.w != SIX_VIEWS) return first;
    vec3 d = p_w - light.position_w.xyz;
    vec3 m = abs(d);
    int axis = m.x >= m.y && m.x >= m.z ? 0 : (m.y >= m.z ? 1 : 2);
    return first + 2 * axis + (d[axis] < 0.0 ? 1 : 0);
}

float tent(float j) {
    return max(float(PCF_RADIUS + 1) - abs(j), 0.0);
}

// Percentage-closer filtering: a tent of (2 PCF_RADIUS + 1)^2 bilinear comparisons. Two neighbouring texels and their
// weights are one bilinear comparison between them, so the same filter takes (PCF_RADIUS + 1)^2.
float filtered_comparison(vec2 uv, float depth) {
    vec2 size = vec2(textureSize(shadow_sheet, 0));
    vec2 at = uv * size - 0.5, base = floor(at), s = at - base;
    vec2 weight[PCF_RADIUS + 1], tap[PCF_RADIUS + 1];
    for (int m = 0; m <= PCF_RADIUS; ++m) {
        float j = float(2 * m - PCF_RADIUS);
        vec2 one = mix(vec2(tent(j)), vec2(tent(j - 1.0)), s), two = mix(vec2(tent(j + 1.0)), vec2(tent(j)), s);
        weight[m] = one + two;
        tap[m] = (base + j + 0.5 + two / weight[m]) / size;
    }
    float sum = 0.0;
    for (int y = 0; y <= PCF_RADIUS; ++y)
        for (int x = 0; x <= PCF_RADIUS; ++x)
            sum += weight[x].x * weight[y].y * textureLod(shadow_sheet, vec3(tap[x].x, tap[y].y, depth), 0.0);
    float total = float((PCF_RADIUS + 1) * (PCF_RADIUS + 1));
    return min(sum / (total * total), 1.0);
}

// The share of the light that nothing blocks.
float visibility(Light light, vec3 p_w, vec3 normal_w, vec3 L) {
    int view = view_of(light, p_w);
    mat4 to_clip = world_to_clip[view];
    float texel_w = light.direction_w.w * (to_clip * vec4(p_w, 1.0)).w;
    // Seen along the ray, a plane's depth at a tap R texels away differs by R texel sinφ / (cosθ |ray|), with φ from
    // the view's axis and θ from the ray. A point moved off the plane by R texel sinφ is nearer by just that, so a
    // plane never shades itself. The farthest texel of the filter is a corner, √2 (PCF_RADIUS + 1) away; the half
    // texel on top covers curvature and rounding.
    vec3 axis = vec3(to_clip[0][3], to_clip[1][3], to_clip[2][3]);
    float cosine = light.position_w.w == DIRECTIONAL ? dot(normal_w, L) : dot(normal_w, axis);
    float reach = 1.41421356 * (float(PCF_RADIUS) + 1.0);
    float offset = texel_w * (reach * sqrt(max(1.0 - cosine * cosine, 0.0)) + 0.5);
    vec4 clip = to_clip * vec4(p_w + normal_w * offset, 1.0);
    vec3 ndc = clip.xyz / clip.w * 0.5 + 0.5;
    vec2 tile = vec2(view % tiles_per_side, view / tiles_per_side);
    return filtered_comparison((tile + clamp(ndc.xy, 0.0, 1.0)) / float(tiles_per_side), ndc.z);
}

// E: K-band irradiance, W m⁻² nm⁻¹ in an absolute scene.
void gather_irradiance(vec3 p_w, vec3 normal_w, out vec4 E[LAYERS]) {
    for (int l = 0; l < LAYERS; ++l) E[l] = vec4(0.0);
    for (int i = 0; i < light_count; ++i) {
        Light light = lights[i];
        if (light.cone.w == 0.0) continue;
        vec3 L;
        float factor = attenuation(light, p_w, normal_w, L);
        if (factor <= 0.0) continue;
        factor *= light.cone.w * visibility(light, p_w, normal_w, L);
        for (int l = 0; l < LAYERS; ++l) E[l] += factor * irradiance_at_1m[i * LAYERS + l];
    }
}
