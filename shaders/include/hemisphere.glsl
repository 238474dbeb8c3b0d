// An orthonormal basis around n (Duff et al. 2017).
void find_basis(vec3 n, out vec3 x, out vec3 y) {
    float s = n.z >= 0.0 ? 1.0 : -1.0;
    float a = -1.0 / (s + n.z), b = n.x * n.y * a;
    x = vec3(1.0 + s * n.x * n.x * a, s * b, -s * n.x);
    y = vec3(b, s + n.y * n.y * a, -n.y);
}

// The direction about +z to a point of the unit square: its density is the cosine over π.
vec3 on_hemisphere(vec2 u) {
    float angle = 6.28318531 * u.y;
    return vec3(sqrt(u.x) * vec2(cos(angle), sin(angle)), sqrt(1.0 - u.x));
}
