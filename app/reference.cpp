// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/reference.h"

#include "satsurf/app/record.h"
#include "satsurf/evaluate/confidence.h"
#include "satsurf/evaluate/table.h"
#include "satsurf/reconstruct/warnings.h"

#include <algorithm>
#include <cctype>
#include <utility>

namespace satsurf::app {
namespace {

using Rows = std::vector<std::vector<std::string>>;

/// A table whose first column is code.
std::string table(const std::vector<std::string>& head, const Rows& rows) {
  std::string out = "|", line = "|";
  for (const std::string& title : head) out += " " + title + " |", line += " --- |";
  out += "\n" + line + "\n";
  for (const auto& row : rows) {
    out += "|";
    for (std::size_t k = 0; k < row.size(); ++k)
      out += k == 0 && !row[k].empty() ? " `" + row[k] + "` |" : " " + row[k] + " |";
    out += "\n";
  }
  return out + "\n";
}

std::string sentence(std::string text) {
  text.front() = static_cast<char>(std::toupper(static_cast<unsigned char>(text.front())));
  return text + ".";
}

Rows rows_of(const std::vector<WrittenFile>& list) {
  Rows rows;
  for (const WrittenFile& file : list) rows.push_back({file.name, file.meaning});
  return rows;
}

/// A flag as a row of the reference: all spellings, and the field's name where it is another.
FieldInfo row_of(const Flag& flag) {
  FieldInfo row = flag.info;
  const std::string spellings = flag.option->get_name(true, true);
  std::string as_name = spellings.substr(spellings.find_first_not_of('-'));
  as_name = as_name.substr(0, as_name.find(','));
  std::ranges::replace(as_name, '-', '_');
  if (as_name != row.name)
    row.help += flag.is_switch && row.value == "true" ? "; in files `" + row.name + "`: false"
                                                      : "; in files `" + row.name + "`";
  row.name.clear();
  for (const char c : spellings) row.name += c == ',' ? std::string(", ") : std::string(1, c);
  if (flag.is_switch) row.type = "switch", row.value.clear();
  return row;
}

/// A table for each heading of the help, of the flags from number `first` on.
std::string flag_tables(const Command& command, std::size_t first) {
  std::vector<std::pair<std::string, std::vector<FieldInfo>>> groups;
  const std::vector<Flag>& flags = command.flags.all();
  for (std::size_t k = first; k < flags.size(); ++k) {
    const std::string& group = flags[k].option->get_group();
    auto at = std::ranges::find(groups, group, [](const auto& g) { return g.first; });
    if (at == groups.end()) at = groups.insert(at, {group, {}});
    at->second.push_back(row_of(flags[k]));
  }
  std::string out;
  for (const auto& [group, rows] : groups)
    out += (groups.size() > 1 ? "#### " + group + "\n\n" : std::string()) + markdown_table(rows) +
           "\n";
  return out;
}

std::string commands_text(const Program& program, std::size_t common) {
  std::string out = "## Commands\n\n";
  for (const Command& command : program.commands) {
    const CLI::App& app = command.flags.command();
    out += "### satsurf " + app.get_name() + "\n\n" + sentence(app.get_description()) + "\n\n";
    out += flag_tables(command, common);
    if (!command.files.empty())
      out += "It writes\n\n" + table({"File", "Content"}, rows_of(command.files));
    if (!command.results.empty())
      out +=
          "The `results` of its record:\n\n" + table({"Key", "Meaning"}, rows_of(command.results));
  }
  return out;
}

Rows pairs_of(const std::vector<std::pair<std::string, std::string>>& pairs) {
  Rows rows;
  for (const auto& [key, meaning] : pairs) rows.push_back({key, meaning});
  return rows;
}

std::string columns_text() {
  const std::vector<evaluate::TableColumn> columns = evaluate::table_columns();
  std::string out =
      "## Columns of evaluate --data --csv\n\n"
      "One row per scene, and a last one `mean` with the mean over the scenes for which a number\n"
      "exists. Cells of numbers that do not exist are empty. After `scene`, its name, come "
      "columns\n"
      "named GROUP_NUMBER; the last one is `seconds`.\n\n";
  Rows groups, numbers;
  for (const auto& [group, meaning] : evaluate::table_groups()) {
    std::string list;
    for (const evaluate::TableColumn& column : columns)
      if (column.group == group) list += (list.empty() ? "`" : " `") + column.number + "`";
    groups.push_back({group, meaning, list});
  }
  for (const evaluate::TableColumn& column : columns)
    if (std::ranges::none_of(numbers, [&](const auto& row) { return row[0] == column.number; }))
      numbers.push_back({column.number, column.unit, column.meaning});
  out += table({"Group", "Of", "Numbers"}, groups);
  out += table({"Number", "Unit", "Meaning"}, numbers);
  std::string head = evaluate::confidence_csv({});
  head.pop_back();
  return out + "## Columns of evaluate --data --confidence-csv\n\n`" + head +
         "`: one row per bin, of `mvs_source` and `dsm`, in bins of `equal_width` and\n"
         "`equal_count`. `low` and `high` bound the confidence, `confidence` is its mean, `share` "
         "is "
         "of all pixels.\n\n";
}

}  // namespace

std::string reference(const Program& program) {
  CommonFlags fresh;
  const std::size_t common = collect_fields(fresh).size();
  std::string out =
      "# Reference\n\n"
      "Every command, flag and file of the `satsurf` program, as `satsurf help --markdown` prints "
      "it.\n"
      "Lists are separated by commas, except files, which are arguments of their own. A switch "
      "takes no\nvalue, or `=false` where the file of `--config` has set it.\n\n";
  out += commands_text(program, common);
  out += "## Flags of every command\n\n";
  const std::vector<Flag>& flags = program.commands.front().flags.all();
  std::vector<FieldInfo> rows;
  for (std::size_t k = 0; k < common; ++k) rows.push_back(row_of(flags[k]));
  out += markdown_table(rows);
  out +=
      "\n## Configurations\n\n"
      "`--config FILE` names a JSON object with any of a command's fields. A field has the name of "
      "its\nflag, with underscores for dashes; a dot is an object in the file (`{\"model\": "
      "{\"base\": 4}}`). Flags\nwin over the file, the file over the defaults, and "
      "`--print-config` shows what is in effect. The\nrecord that a command writes (`run.json`, or "
      "the file of `evaluate --json`) is such a file too: it\nrepeats the run, but brings neither "
      "the places of results nor, of `train`, `--data` and `--seed`.\n\n"
      "## Records\n\n";
  out += table({"Key", "Meaning"}, pairs_of(record_keys()));
  out += "## Warnings of reconstruct\n\n" +
         table({"Code", "Where"}, pairs_of(reconstruct::warning_codes())) +
         "Besides, PART_failed where a part could not be made that the surface can do without: "
         "orthophoto,\npictures, mesh or report; tile_failed where a tile could not be made; "
         "dem_unused where the terrain of --dem\nsays no heights.\n\n";
  out += columns_text();
  out += "## Exit codes\n\n" +
         table({"Code", "Meaning"}, {{"0", "done"},
                                     {"1", "failed: one line on stderr says why"},
                                     {"2", "wrong usage: a flag, or the file that --config names"},
                                     {"128 + n", "stopped by signal n (130: Ctrl-C)"}});
  out += "## Environment\n\n" +
         table({"Variable", "Meaning"},
               {{"SATSURF_WEIGHTS", "the weights that no --weights names, instead of the shipped"},
                {"SATSURF_ISA",
                 "instruction set: baseline, avx2 or avx512 instead of the best there is"},
                {"SATSURF_GDAL_DRIVERS",
                 "further drivers of GDAL to trust, separated by commas, beside --gdal-drivers"}});
  out.pop_back();
  return out;
}

}  // namespace satsurf::app
