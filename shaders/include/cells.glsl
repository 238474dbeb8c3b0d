// The tree of cells in the order of a walk: a cell is followed by those that it is made of.
struct Cell { // as `Cells.walk` has it
    vec4 low;  // of a box around all that it stands for; w: the cell after its last descendant, negative where it glows
    vec4 high;
    vec4 aim;  // its middle; w: how far from there it may stand for its parts where what it sends matters; negative: anywhere
    vec4 N, U, V; // distance from the plane, and shares of the sides, of a point
    vec4 halves;  // of one that is made of halves: negative in the first
    vec4 more; // how far all that it stands for reaches from the plane; the most of u + v; whether it is made of halves
};

// What lies nearer to a plane is in it, in units of the scene's radius: float32 of G-buffer and atlas.
const float COPLANAR = 2e-5;

layout(std430, binding = 0) readonly buffer Walk { Cell cells[]; };
uniform int cell_count;

uint after(uint cell) {
    return uint(abs(cells[cell].low.w));
}

bool glows(uint cell) {
    return cells[cell].low.w < 0.0;
}

// Whether a cell's middle is as far from all of a sphere as that; always, where that is none.
bool is_apart(vec4 sphere, vec3 middle, float least) {
    vec3 to = middle - sphere.xyz;
    return least <= 0.0 || dot(to, to) >= (least + sphere.w) * (least + sphere.w);
}

// Around its box.
vec4 sphere_of(uint cell) {
    vec3 low = cells[cell].low.xyz, high = cells[cell].high.xyz;
    return vec4(0.5 * (low + high), 0.5 * distance(low, high));
}
