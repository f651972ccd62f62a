// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/record.h"

#include "satsurf/app/sha256.h"
#include "satsurf/core/atomic_file.h"
#include "satsurf/core/block_pool.h"
#include "satsurf/core/error.h"
#include "satsurf/core/isa.h"
#include "satsurf/core/parallel.h"
#include "satsurf/core/tensor.h"
#include "satsurf/core/version.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <ctime>
#include <system_error>
#include <utility>
#include <variant>

#include <sys/resource.h>
#include <unistd.h>

namespace satsurf::app {
namespace {

constexpr const char* kProgram = "satsurf";

std::string host_name() {
  std::array<char, 256> name{};
  return ::gethostname(name.data(), name.size() - 1) == 0 ? name.data() : "unknown";
}

/// Largest resident size of this process so far.
std::uint64_t peak_memory_bytes() {
  rusage usage{};
  ::getrusage(RUSAGE_SELF, &usage);
  return static_cast<std::uint64_t>(usage.ru_maxrss) * 1024;  // Linux counts in KiB
}

std::string utc(std::chrono::system_clock::time_point time) {
  const std::time_t seconds = std::chrono::system_clock::to_time_t(time);
  std::tm parts{};
  ::gmtime_r(&seconds, &parts);
  std::array<char, 32> text{};
  std::strftime(text.data(), text.size(), "%Y-%m-%dT%H:%M:%SZ", &parts);
  return text.data();
}

}  // namespace

nlohmann::ordered_json json_number(double v) {
  return std::isfinite(v) ? nlohmann::ordered_json(v) : nlohmann::ordered_json(nullptr);
}

RunRecord::RunRecord(std::string command, nlohmann::json config, std::uint64_t seed)
    : command_(std::move(command)),
      config_(std::move(config)),
      seed_(seed),
      started_(std::chrono::system_clock::now()),
      clock_(std::chrono::steady_clock::now()) {}

void RunRecord::add_input(const std::filesystem::path& path) {
  std::vector<std::filesystem::path> files;
  try {
    if (std::filesystem::is_directory(path)) {
      for (const auto& entry : std::filesystem::recursive_directory_iterator(path))
        if (entry.is_regular_file()) files.push_back(entry.path());
      std::ranges::sort(files);
    } else {
      files.push_back(path);
    }
  } catch (const std::filesystem::filesystem_error& e) {
    throw IoError(path.string() + ": cannot be read (" + e.code().message() + ")");
  }
  std::erase_if(files, [&](const auto& file) {
    return std::ranges::any_of(inputs_, [&](const Input& i) { return i.path == file.string(); });
  });
  std::vector<Input> found(files.size());
  for_each_index(static_cast<Index>(files.size()), [&](Index i) {
    const auto& file = files[static_cast<std::size_t>(i)];
    std::string hash = sha256_of_file(file);  // refuses what is not a file
    std::error_code ec;
    found[static_cast<std::size_t>(i)] = {file.string(), std::filesystem::file_size(file, ec),
                                          std::move(hash)};
  });
  inputs_.insert(inputs_.end(), found.begin(), found.end());
}

void RunRecord::add_warning(const std::string& code, const std::string& text) {
  warnings_.emplace_back(code, text);
}

double RunRecord::seconds() const {
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - clock_).count();
}

nlohmann::ordered_json RunRecord::json() const {
  nlohmann::ordered_json inputs = nlohmann::ordered_json::array();
  for (const Input& i : inputs_)
    inputs.push_back({{"path", i.path}, {"bytes", i.bytes}, {"sha256", i.sha256}});
  nlohmann::ordered_json warnings = nlohmann::ordered_json::array();
  for (const auto& [code, text] : warnings_) warnings.push_back({{"code", code}, {"text", text}});
  nlohmann::ordered_json j;
  j["program"] = kProgram;
  j["version"] = program_version();
  j["git"] = program_git_hash();
  j["command"] = command_;
  j["config"] = config_;
  j["seed"] = seed_;
  j["host"] = host_name();
  j["isa"] = isa_name(active_isa());
  j["threads"] = threads();
  j["started"] = utc(started_);
  j["wall_seconds"] = seconds();
  j["peak_memory_bytes"] = peak_memory_bytes();
  j["peak_tensor_bytes"] = peak_tensor_bytes();
  j["inputs"] = inputs;
  j["warnings"] = warnings;
  j["results"] = results_;
  return j;
}

std::filesystem::path in_full(const std::filesystem::path& path) {
  if (path.empty()) return path;
  std::error_code gone;  // the working directory; then nothing better is known than what came
  const std::filesystem::path full = std::filesystem::absolute(path, gone);
  return gone ? path : full;
}

void name_in_full(const std::vector<FieldRef>& fields) {
  using Path = std::filesystem::path;
  for (const FieldRef& field : fields)
    if (Path* const* one = std::get_if<Path*>(&field.target))
      **one = in_full(**one);
    else if (std::vector<Path>* const* list = std::get_if<std::vector<Path>*>(&field.target))
      for (Path& path : **list) path = in_full(path);
}

std::vector<std::pair<std::string, std::string>> record_keys() {
  return {{"program", "satsurf"},
          {"version", "of the program"},
          {"git", "commit it was built from, -dirty with changes"},
          {"command", "what ran"},
          {"config", "settings in effect, defaults and full paths included; --config takes it"},
          {"seed", "of what is random, 0 where nothing is"},
          {"host", "name of the machine"},
          {"isa", "instruction set: baseline, avx2 or avx512"},
          {"threads", "most that were used"},
          {"started", "time in UTC"},
          {"wall_seconds", "how long it took"},
          {"peak_memory_bytes", "largest resident size"},
          {"peak_tensor_bytes", "largest size of all tensors together"},
          {"inputs", "files that were read: path, bytes, sha256"},
          {"warnings", "reasons to look twice at the outcome: code, text"},
          {"results", "what came of it"}};
}

void RunRecord::save(const std::filesystem::path& path) const {
  // A path need not be UTF-8; a record with a replaced letter is better than none.
  atomic_write(path, json().dump(2, ' ', false, nlohmann::json::error_handler_t::replace) + '\n');
}

nlohmann::json load_config(const std::filesystem::path& path, const std::string& command) {
  nlohmann::json j;
  try {
    j = load_json_file(path);
  } catch (const IoError& e) {  // what is wrong with a configuration is wrong usage
    throw ConfigError(e.what());
  }
  if (!j.is_object() || j.value("program", nlohmann::json()) != kProgram || !j.contains("config"))
    return j;
  if (const nlohmann::json made_by = j.value("command", nlohmann::json()); made_by != command)
    throw ConfigError(path.string() + ": the record of " + made_by.dump() + ", expected one of " +
                      nlohmann::json(command).dump());
  return j["config"];
}

bool holds_run(const std::filesystem::path& folder) {
  try {
    const nlohmann::json j = load_json_file(folder / "run.json");
    if (!j.is_object() || j.value("program", nlohmann::json()) != kProgram) return false;
    const nlohmann::json command = j.value("command", nlohmann::json());
    return command == "simulate" || command == "train" || command == "reconstruct";
  } catch (const Error&) {  // no such file, or somebody else's
    return false;
  }
}

}  // namespace satsurf::app
