/* Read q, v, a (n each) and gravity (3) from standard input; write link poses, joint twists, their rates, and torques. */
#include <stdio.h>

#include HEADER

enum { MAX_NUMBERS = 1 << 14, MAX_INPUT = 3 * 64 + 3 };

static int write_numbers(const double *x, int count)
{
    return fwrite(x, sizeof(double), (size_t)count, stdout) == (size_t)count;
}

int main(void)
{
    static double block[MAX_NUMBERS], work[MAX_NUMBERS], tau[64], in[MAX_INPUT];
    const gf_hand_model *hand = &HAND;
    const int n = hand->motor_count, joints = hand->joint_count;
    const gf_hand_motion motion = gf_map_hand_motion(hand, block);
    if (gf_hand_motion_size(hand) > MAX_NUMBERS || gf_hand_dynamics_work_size(hand) > MAX_NUMBERS) return 1;
    while (fread(in, sizeof(double), (size_t)(3 * n + 3), stdin) == (size_t)(3 * n + 3)) {
        gf_move_hand(hand, in, in + n, &motion);
        gf_hand_inverse_dynamics(hand, &motion, in + 2 * n, in + 3 * n, work, tau);
        if (!write_numbers(motion.link_poses, 12 * (joints + 1)) || !write_numbers(motion.joint_twists, 6 * joints) ||
            !write_numbers(motion.joint_twist_rates, 6 * joints) || !write_numbers(tau, n))
            return 1;
    }
    return 0;
}
