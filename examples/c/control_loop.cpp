// The control loop of control_loop.c in C++17.
#include <array>
#include <cstddef>
#include <cstdio>
#include <vector>

#include "grasp_controller.h"

namespace {

constexpr std::size_t n = GRASP_MOTOR_COUNT;

// One state: measured joints and object, and the desired motion of the object.
struct State {
    std::array<gf_real, n> q, v;
    std::array<gf_real, 3> p_HO;
    std::array<gf_real, 9> R_HO;
    std::array<gf_real, 6> twist;
    std::array<gf_real, 3> p_d;
    std::array<gf_real, 9> R_d;
    std::array<gf_real, 6> twist_d, acceleration_d;
};

// A controller and its memory, which is allocated once.
class Controller {
public:
    explicit Controller(const gf_controller_setup &setup)
        : memory_(gf_controller_size(&setup)), controller_(gf_controller_init(&setup, memory_.data(), memory_.size()))
    {
    }

    bool is_valid() const { return controller_ != nullptr; }

    gf_control_status step(const State &state, gf_control_outputs &outputs)
    {
        gf_control_inputs inputs{};
        inputs.q = state.q.data();
        inputs.v = state.v.data();
        inputs.p_HO = state.p_HO.data();
        inputs.R_HO = state.R_HO.data();
        inputs.twist = state.twist.data();
        inputs.p_d = state.p_d.data();
        inputs.R_d = state.R_d.data();
        inputs.twist_d = state.twist_d.data();
        inputs.acceleration_d = state.acceleration_d.data();
        return gf_controller_step(controller_, &inputs, &outputs);
    }

private:
    std::vector<unsigned char> memory_;
    gf_controller *controller_;
};

} // namespace

int main()
{
    Controller controller(grasp_controller);
    if (!controller.is_valid()) return 1;
    State state;
    gf_control_outputs outputs;
    while (std::fread(&state, sizeof state, 1, stdin) == 1) {
        controller.step(state, outputs);
        if (std::fwrite(outputs.tau, sizeof(gf_real), n, stdout) != n) return 1;
    }
    return 0;
}
